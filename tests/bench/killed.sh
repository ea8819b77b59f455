#!/usr/bin/env bash
# What an experiment loses when it is killed:
#
#     tests/bench/killed.sh LABORATORY FOLDER KILLS [EXPERIMENT ARGUMENT...]
#
# Works it twice in FOLDER, which it makes: once undisturbed, once killed (-9) KILLS times at random moments and gone on with. Ends
# with 1 where a kill lost or changed a cell that was finished, where the two differ in a cell's key or value or in a byte of
# a report, or where no kill met it at work. HOLDPOINT_KILL_SEED is the seed of the moments [default: 1].
set -euo pipefail
export LC_ALL=C
[ $# -ge 3 ] || { sed -n '2,4s/^# \{0,1\}//p' "$0" >&2; exit 2; }
laboratory="$(realpath "$1")" folder="$2" kills="$3"
shift 3
[ $# -gt 0 ] || set -- ablation --preset smoke
experiment=("$@")
[ ! -e "$folder" ] || { echo "$folder is there already" >&2; exit 2; }
mkdir -p "$folder"
folder="$(realpath "$folder")"
RANDOM="${HOLDPOINT_KILL_SEED:-1}"

work() { exec "$laboratory" experiment "${experiment[@]}" --out "$folder/$1" --cache-key "$folder/key"; }

# cells NAME: the digest of every finished cell.
cells() { (cd "$folder/$1/kept" 2>/dev/null && find . -type f ! -name '*.part' -exec sha256sum {} + | sort) || true; }

began="$SECONDS"
(work whole) >"$folder/whole.log" 2>&1 || { tail -n 3 "$folder/whole.log" >&2; exit 1; }
whole_secs=$((SECONDS - began + 1))

met=0
cells killed >"$folder/before"
for ((kill = 1; kill <= kills; kill++)); do
    (work killed) >"$folder/killed.log" 2>&1 &
    pid=$!
    # From a twentieth of a second on, so that all kills together take about as long as the undisturbed work.
    sleep "$(awk -v r="$RANDOM" -v all="$whole_secs" -v n="$kills" 'BEGIN { print .05 + 2 * all / n * r / 32768 }')"
    kill -9 "$pid" 2>/dev/null || true
    # One that had ended by itself ends otherwise than by a signal, killed or not.
    code=0
    wait "$pid" 2>/dev/null || code=$?
    if [ "$code" -eq 137 ]; then met=$((met + 1)); fi
    cells killed >"$folder/after"
    if lost="$(comm -23 "$folder/before" "$folder/after" | head -n 1)" && [ -n "$lost" ]; then
        echo "kill $kill lost a finished cell: $lost" >&2
        exit 1
    fi
    mv "$folder/after" "$folder/before"
done
kept="$(wc -l <"$folder/before")"
(work killed) >"$folder/killed.log" 2>&1 || { tail -n 3 "$folder/killed.log" >&2; exit 1; }
diff -r --exclude='*.part' "$folder/whole" "$folder/killed" >"$folder/diff" \
    || { echo "it is not what the undisturbed run made: $(head -n 1 "$folder/diff")" >&2; exit 1; }
[ "$met" -gt 0 ] || { echo "no kill met it at work" >&2; exit 1; }
echo "$met of $kills kills met it at work, and no finished cell was lost: $kept of $(wc -l <<<"$(cells killed)") were finished by then."
echo "Cells are the same by key and value, reports byte by byte."
