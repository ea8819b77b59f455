#!/usr/bin/env bash
# How an experiment scales over jobs and shards, and whether it comes to the same:
#
#     tests/bench/scaling.sh LABORATORY FOLDER [EXPERIMENT ARGUMENT...]
#
# Works it with one job, with two, as two shards one after the other and as two shards at once, each from nothing in a folder of
# its own; joins the shards' cells and writes their report. Prints a table of processor and wall seconds, and ends with 1 where
# cells differ by key or value, or reports by a byte. Nothing else should be at work.
set -euo pipefail
exec 3>&2
export LC_ALL=C TIMEFORMAT='%R %U %S'
[ $# -ge 2 ] || { sed -n '2,5s/^# \{0,1\}//p' "$0" >&2; exit 2; }
laboratory="$(realpath "$1")" folder="$2"
shift 2
[ $# -gt 0 ] || set -- e1 --preset paper-fig4 --pools 1
experiment=("$@")
[ ! -e "$folder" ] || { echo "$folder is there already" >&2; exit 2; }
mkdir -p "$folder"
folder="$(realpath "$folder")"

# works NAME ARGUMENT...: works the experiment into a folder of that name.
works() {
    local name="$1"
    shift
    "$laboratory" experiment "${experiment[@]}" --out "$folder/$name" --cache-key "$folder/key" "$@" \
        >"$folder/$name.log" 2>&1 || { tail -n 3 "$folder/$name.log" >&3; return 1; }
}

# timed NAME COMMAND...: the command's seconds, those of its children included, into NAME.secs.
timed() {
    local name="$1"
    shift
    { time "$@"; } 2>"$folder/$name.secs"
}

one_after_the_other() { works "$1-1" --jobs 1 --shard 1/2 && works "$1-2" --jobs 1 --shard 2/2; }

at_once() {
    works "$1-1" --jobs 1 --shard 1/2 &
    local first=$!
    works "$1-2" --jobs 1 --shard 2/2
    wait "$first"
}

# joined NAME: the cells of both shards together, and the report from them.
joined() {
    mkdir -p "$folder/$1/kept"
    cp -r "$folder/$1-1/kept/." "$folder/$1-2/kept/." "$folder/$1/kept/"
    works "$1" --jobs 1
}

timed jobs-1 works jobs-1 --jobs 1
timed jobs-2 works jobs-2 --jobs 2
timed shards one_after_the_other shards
timed at-once at_once at-once
timed shards-report joined shards
timed at-once-report joined at-once

cells() { find "$folder/$1/kept" -type f | wc -l; }
row() {
    local secs
    secs="$(cat "$folder/$2.secs")"
    echo "$secs" | awk -v what="$1" -v cells="$(cells "$3")" \
        '{ printf "| %s | %d | %.1f | %.1f |\n", what, cells, $2 + $3, $1 }'
}
echo "| how \`experiment ${experiment[*]}\` is worked | cells | processor, s | wall, s |"
echo "| --- | --- | --- | --- |"
row "one process, one job" jobs-1 jobs-1
row "one process, two jobs" jobs-2 jobs-2
row "shards 1/2 and 2/2, one after the other" shards shards
row "report from the joined cells" shards-report shards
row "shards 1/2 and 2/2 at once" at-once at-once
row "report from the joined cells" at-once-report at-once

for other in jobs-2 shards at-once; do
    diff -r "$folder/jobs-1" "$folder/$other" >"$folder/$other.diff" \
        || { echo "$other is not what one job made: $(head -n 1 "$folder/$other.diff")" >&2; exit 1; }
done
echo
echo "Cells are the same by key and value, reports byte by byte."
