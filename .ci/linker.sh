#!/usr/bin/env bash
# Writes a linker for an older C library, for what the machine's own compiler made. Cargo need not compile anything anew for it.
#
#   .ci/linker.sh PYTHON GLIBC FILE     a PYTHON that has ziglang; GLIBC such as 2.28
#
# Zig has the stubs of every glibc, and its own libunwind in place of libgcc_s.
set -euo pipefail
cat >"$3" <<SCRIPT
#!/usr/bin/env bash
arguments=()
for argument in "\$@"; do
    case "\$argument" in -m64 | -lgcc_s | -Wl,--as-needed) ;; *) arguments+=("\$argument") ;; esac
done
exec "$1" -m ziglang cc -target $(uname -m)-linux-gnu.$2 "\${arguments[@]}" -lunwind
SCRIPT
chmod +x "$3"
