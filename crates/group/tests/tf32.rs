//! The switch of TF32, which is of the whole process, in a process of its own.

#![allow(missing_docs, clippy::unwrap_used, reason = "a test")]

use gleaner_group::{allow_tf32, tf32_allowed};

#[test]
fn tf32_is_allowed_as_long_as_it_is_asked_for() {
    assert!(!tf32_allowed().unwrap(), "convolutions alone");
    for allowed in [true, false, true] {
        allow_tf32(allowed).unwrap();
        assert_eq!(tf32_allowed().unwrap(), allowed);
    }
}
