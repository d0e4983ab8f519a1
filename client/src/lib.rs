//! The gleaner client library and command line.
