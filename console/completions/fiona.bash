# Completion of fiona for bash: fiona itself says what could stand next.
_fiona() {
  local line=${COMP_LINE:0:COMP_POINT} candidate prefix word
  line=${line#"${line%%[![:blank:]]*}"}
  [[ $line == *[[:blank:]]* ]] || return
  line=${line#*[[:blank:]]}
  # Bash breaks words at = too: what stands before its word is not to be given again.
  word=${line##*[[:blank:]]}
  prefix=
  [[ $word == *=* ]] && prefix=${word%=*}=
  COMPREPLY=()
  while IFS= read -r candidate; do COMPREPLY+=("${candidate#"$prefix"}"); done < <("$1" complete "$line" 2>/dev/null)
  [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *[=/.] ]] && compopt -o nospace
}
complete -F _fiona fiona
