# Names in the store that the command line names, of the kind asked for.
_holdpoint_stored() {
    local -a store=()
    local i
    for ((i = 1; i < COMP_CWORD; i++)); do
        case "${COMP_WORDS[i]}" in
            --data=*) store=("${COMP_WORDS[i]}") ;;
            --data)
                [[ "${COMP_WORDS[i + 1]}" == "=" ]] && ((i++))
                store=(--data "${COMP_WORDS[i + 1]/#\~/$HOME}")
                ;;
        esac
    done
    "${COMP_WORDS[0]}" "${store[@]}" completions --list "$1" 2>/dev/null
}

# bash splits words at the `@` of a version: put together again before, and taken apart after completing.
_holdpoint_whole() {
    local line="${COMP_LINE:0:COMP_POINT}"
    local word="${line##*[[:space:]]}"
    if [[ "$word" != *@* || "$COMP_WORDBREAKS" != *@* ]]; then
        _holdpoint "$@"
        return
    fi
    local -a COMP_WORDS
    local i COMP_CWORD
    read -ra COMP_WORDS <<<"${line%"$word"}"
    COMP_CWORD=${#COMP_WORDS[@]}
    COMP_WORDS+=("$word")
    _holdpoint "$1" "$word" "${COMP_WORDS[COMP_CWORD - 1]}"
    for i in "${!COMPREPLY[@]}"; do
        COMPREPLY[i]="${COMPREPLY[i]#"${word%"${word##*@}"}"}"
    done
}
