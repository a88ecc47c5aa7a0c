#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# get_blender.sh SUITE DIR [extra packages]
# A real Blender program from a newer Debian suite of the configured mirror, unpacked into DIR
# with the host's own apt and dpkg-deb; the host's package state is not touched.
#   SUITE trixie: Blender 4.3.2, Python 3.13 (stable, about 30 s, 0.3 GB down, 1.1 GB unpacked)
#   SUITE sid:    Blender 5.2, Python 3.14 (moves; never let a build depend on it)
# Writes DIR.run: `DIR.run blender -b ...` runs a program of the tree in a private mount namespace
# (needs root: unshare + chroot) with the same paths as on the host: /proc, /dev, /tmp and the
# current repository are bound in; name more folders in BIND="/a /b".
set -euo pipefail
SUITE=$1 DIR=$(realpath -m "$2"); shift 2
PACKAGES=(blender python3-numpy python3-requests coreutils bash dash
          libgl1 libglx-mesa0 libgl1-mesa-dri libegl1 libegl-mesa0 xvfb "$@")
APT=$DIR.apt
mkdir -p "$DIR" "$APT"/{lists/partial,cache/archives/partial}
MIRROR=$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | grep -v security | head -1)
echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $MIRROR $SUITE main" >"$APT/sources.list"
: >"$APT/status"
OPTIONS=(-q=2 -o Dir::Etc::sourcelist="$APT/sources.list" -o Dir::Etc::sourceparts=/dev/null
         -o Dir::Etc::preferencesparts=/dev/null -o Dir::State::Lists="$APT/lists"
         -o Dir::State::status="$APT/status" -o Dir::Cache="$APT/cache" -o APT::Install-Recommends=false
         -o Acquire::Languages=none -o Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false
         -o APT::Sandbox::User=root -o Acquire::Check-Valid-Until=false -o Acquire::Check-Date=false
         -o Debug::NoLocking=1 -o APT::Keep-Downloaded-Packages=true)
apt-get "${OPTIONS[@]}" update
apt-get "${OPTIONS[@]}" install -y --download-only "${PACKAGES[@]}" >/dev/null

mkdir -p "$DIR"/usr/{bin,sbin,lib,lib64}
for d in bin sbin lib lib64; do ln -sfn usr/$d "$DIR/$d"; done
ls "$APT"/cache/archives/*.deb | xargs -P2 -n1 sh -c \
  'dpkg-deb --fsys-tarfile "$1" | tar -x --keep-directory-symlink -C "$0" \
     --exclude=./usr/share/doc --exclude=./usr/share/man "--exclude=./usr/share/locale/*/LC_MESSAGES/[!b]*"' "$DIR"

# what the packages' maintainer scripts would have done
cd "$DIR"; mkdir -p etc/ld.so.conf.d tmp proc root dev var/lib
LIB=usr/lib/$(dpkg-architecture -qDEB_HOST_MULTIARCH 2>/dev/null || echo x86_64-linux-gnu)
printf '/%s/blas\n/%s/lapack\n/%s/pulseaudio\n' $LIB $LIB $LIB >etc/ld.so.conf.d/zz-alternatives.conf
[ -f etc/ld.so.conf ] || echo 'include /etc/ld.so.conf.d/*.conf' >etc/ld.so.conf
[ -f etc/passwd ] || echo 'root:x:0:0:root:/root:/bin/sh' >etc/passwd
[ -e bin/sh ] || ln -s dash bin/sh
ln -sf /proc/mounts etc/mtab
ldconfig -r "$DIR"
# Blender >= 5.2: its extensions add-on imports cattrs, which Debian does not package
if [ -d usr/share/blender/scripts/modules/_bpy_internal/http ]; then
  PY=$(ls -d usr/lib/python3.1[0-9] | sed 's#.*python##')
  python3 -m pip install -q --python-version "$PY" --only-binary :all: --platform manylinux_2_28_x86_64 \
    --target usr/lib/python3/dist-packages cattrs
fi
cat >"$DIR.run" <<RUN
#!/bin/bash
# run a program of the tree beside this file; the mounts end with it
ROOT=$DIR
REPO=\$(git rev-parse --show-toplevel 2>/dev/null || pwd)
exec unshare -m --propagation private bash -c '
  root=\$1; binds=\$2; shift 2
  for d in /proc /dev /tmp \$binds; do [ -d "\$d" ] && { mkdir -p "\$root\$d"; mount --rbind "\$d" "\$root\$d"; }; done
  here=\$PWD; exec chroot "\$root" /usr/bin/env -C "\$here" "\$@"' _ "\$ROOT" "\$REPO \${BIND:-}" "\$@"
RUN
chmod +x "$DIR.run"
