#!/bin/bash
# Does any file cost more than a general-purpose coder makes of it?
#
#   benches/floor.sh FOLDER [LEVEL]      LEVEL: 6 if not given
#
# Encodes every file of the folder and those below on its own, checks that it comes back, and compares the stream
# with `xz -9e` (level 4 and up) or `zstd -3` (below). Prints file, their bytes, ours and the ratio of the two.
# Exit code 1 if any stream is larger by more than 2 % and 200 bytes, or does not come back.
# The program is `lidarpc`, or what LIDARPC names.

set -u
folder=${1:?usage: benches/floor.sh FOLDER [LEVEL]}
level=${2:-6}
lidarpc=${LIDARPC:-lidarpc}
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

bad=0
printf '%-60s %10s %10s %7s\n' file "$([ "$level" -ge 4 ] && echo 'xz -9e' || echo 'zstd -3')" lidarpc ratio
while IFS= read -r -d '' file; do
    if [ "$level" -ge 4 ]; then
        theirs=$(xz -9e -T1 -c "$file" | wc -c)
    else
        theirs=$(zstd -3 -q -c "$file" | wc -c)
    fi
    rm -rf "$work"/*
    "$lidarpc" encode "$file" -o "$work/a.lpc" --level "$level" --force-bytes --quiet &&
        "$lidarpc" decode "$work/a.lpc" -o "$work/back" --quiet
    remark=
    cmp -s "$file" "$work/back/$(basename "$file")" || remark=' does not come back'
    ours=$(wc -c < "$work/a.lpc")
    [ "$ours" -le $((theirs + theirs / 50 + 200)) ] || remark="$remark larger"
    [ -z "$remark" ] || bad=1
    printf '%-60s %10d %10d %7.3f%s\n' "${file#"$folder"/}" "$theirs" "$ours" \
        "$(awk "BEGIN { print $ours / $theirs }")" "$remark"
done < <(find "$folder" -type f -print0 | sort -z)
exit $bad
