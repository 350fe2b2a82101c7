# Completion of fiona for fish: fiona itself says what could stand next.
function __fiona_candidates
    set -l line (commandline -cp | string replace -r '^\s*\S+\s+' '' | string collect --allow-empty)
    fiona complete "$line" 2>/dev/null
end
complete -c fiona -f -a '(__fiona_candidates)'
