//! End-to-end tests: a real server, real workers, real clients.
