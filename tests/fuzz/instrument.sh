#!/bin/sh
# Cargo calls this in place of rustc (RUSTC_WRAPPER). Our crates, the targets (by their folder: a crate of others is named `object`, too) and
# the readers of MCAP, STL and WebSocket frames get coverage for libFuzzer and the checks of a
# debug build. All others stay as they are: that saves most of the time, and some of them are also linked into build scripts, which
# have no libFuzzer.
case " $* " in
*" --crate-name fiatlux"* | *" --crate-name mcap "* | *" --crate-name tungstenite "* | *" --crate-name stl_io "* | *" targets/"*)
    exec "$@" -C passes=sancov-module -C llvm-args=-sanitizer-coverage-level=4 \
        -C llvm-args=-sanitizer-coverage-inline-8bit-counters -C llvm-args=-sanitizer-coverage-pc-table \
        -C llvm-args=-sanitizer-coverage-trace-compares -C debug-assertions -C overflow-checks
    ;;
*) exec "$@" ;;
esac
