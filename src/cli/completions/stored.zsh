# Names in the store that the command line names, of the kind asked for.
_holdpoint_stored() {
    local -a typed store stored
    local i
    typed=("${(@Q)${(@z)LBUFFER}}")
    for (( i = 2; i <= ${#typed}; i++ )); do
        case "${typed[i]}" in
            --data=*) store=(--data "${${typed[i]#--data=}/#\~/$HOME}") ;;
            --data) store=(--data "${typed[i + 1]/#\~/$HOME}") ;;
        esac
    done
    stored=("${(@f)$("${typed[1]}" "${store[@]}" completions --list "$1" 2>/dev/null)}")
    stored=(${stored:#})
    (( ${#stored} )) && compadd -a stored
}

# Where no version fits, a candidate's folder or a recording's file may be meant.
_holdpoint_versions() { _holdpoint_stored versions || _files }
_holdpoint_families() { _holdpoint_stored families }
_holdpoint_subjects() { _holdpoint_stored subjects }

