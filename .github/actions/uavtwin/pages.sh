#!/usr/bin/env bash
# pages.sh OUT: writes a page of `uavtwin why` and the answer of `uavtwin check` for each log, and a summary.
# LOGS, REFERENCES: a file per line; BASE: the commit before, where LOGS is empty; FAIL_ON: nothing, unreadable, fault.
set -uo pipefail
out=$1
mkdir -p "$out"
summary=${GITHUB_STEP_SUMMARY:-/dev/stdout}

logs=()
if [[ -n ${LOGS:-} ]]; then
    mapfile -t logs <<<"$LOGS"
elif [[ -n ${BASE:-} ]]; then
    while IFS= read -r -d '' file; do
        case ${file,,} in *.ulg | *.bin | *.bbl | *.bfl | *.tlog) logs+=("$file") ;; esac
    done < <(git diff --name-only --diff-filter=AM -z "$BASE"...HEAD)
fi

references=()
while IFS= read -r file; do
    [[ -n $file ]] && references+=(--reference "$file")
done <<<"${REFERENCES:-}"

unreadable=0 faults=0 count=0
{
    echo "| log | what happened |"
    echo "|---|---|"
} >>"$summary"
for log in "${logs[@]}"; do
    [[ -n $log ]] || continue
    count=$((count + 1))
    name=$(printf '%03d-%s' "$count" "$(basename -- "$log" | tr -c 'A-Za-z0-9._\n-' '_')")
    uavtwin check --json -- "$log" >"$out/$name.check.json"
    said=$(uavtwin why "${references[@]}" --out "$out/$name.html" --force -- "$log" 2>&1)
    code=$?
    [[ $code -eq 1 ]] && faults=$((faults + 1))
    [[ $code -ge 2 ]] && unreadable=$((unreadable + 1))
    echo "| \`$name\` | $(head -n 1 <<<"$said" | tr '|<>`' '    ') |" >>"$summary"
done
echo "$count logs: $faults in which something went wrong, $unreadable that cannot be read." >>"$summary"

case ${FAIL_ON:-unreadable} in
nothing) exit 0 ;;
unreadable) exit $((unreadable > 0)) ;;
fault) exit $((unreadable + faults > 0)) ;;
*) echo "fail-on: write nothing, unreadable or fault" >&2; exit 2 ;;
esac
