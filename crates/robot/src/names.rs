//! The robots that come with the library.

// `ROBOTS`: name, hands and text of each file of `robots/`; the build script writes the list.
include!(concat!(env!("OUT_DIR"), "/robots.rs"));

/// Their names. The first is the benchmark's.
pub(crate) const NAMES: [&str; ROBOTS.len()] = {
    let mut names = [""; ROBOTS.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = ROBOTS[index].0;
        index += 1;
    }
    names
};
