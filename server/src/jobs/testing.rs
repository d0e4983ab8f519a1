//! Fixtures for the tests of this room.
