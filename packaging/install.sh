#!/bin/sh
# Add TissueID to the menu of the desktop, the path, the manual pages and the completions of the current user.
# `./install.sh --remove` takes them away again. Nothing is copied but small files: leave this folder where it is.
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd -P)
data=${XDG_DATA_HOME:-$HOME/.local/share}
bin=$HOME/.local/bin
if [ "${1:-}" = --remove ]; then
    rm -f "$bin/tissueid" "$bin/tissueid-firmware-sim" "$data/applications/tissueid.desktop" "$data/man/man1/tissueid.1" \
        "$data/icons/hicolor/scalable/apps/tissueid.svg" "$data/bash-completion/completions/tissueid"
    echo "TissueID is removed from the menu; its folder $here can be deleted"
    exit 0
fi
mkdir -p "$bin" "$data/applications" "$data/man/man1" "$data/icons/hicolor/scalable/apps" "$data/bash-completion/completions"
ln -sf "$here/bin/tissueid" "$bin/tissueid"
ln -sf "$here/bin/tissueid-firmware-sim" "$bin/tissueid-firmware-sim"
sed "s|^Exec=.*|Exec=\"$here/bin/tissueid\"|" "$here/share/applications/tissueid.desktop" >"$data/applications/tissueid.desktop"
cp "$here/share/man/man1/tissueid.1" "$data/man/man1/"
cp "$here/share/icons/hicolor/scalable/apps/tissueid.svg" "$data/icons/hicolor/scalable/apps/"
cp "$here/share/bash-completion/completions/tissueid" "$data/bash-completion/completions/"
echo "TissueID is in the menu; tissueid is in $bin"
