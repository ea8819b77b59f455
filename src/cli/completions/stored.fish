# Names in the store that the command line names, of the kind asked for.
function __holdpoint_stored
    set -l words (commandline -opc)
    set -l store
    for i in (seq 2 (count $words))
        switch $words[$i]
            case '--data=*'
                set store (string replace -r -- '^--data=~' "--data=$HOME" $words[$i])
            case --data
                set -q words[(math $i + 1)]
                and set store --data (string replace -r -- '^~' $HOME $words[(math $i + 1)])
        end
    end
    $words[1] $store completions --list $argv[1] 2>/dev/null
end
