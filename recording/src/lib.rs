//! MCAP recordings to aligned steps and back.
