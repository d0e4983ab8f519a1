//! Training and running policies.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod finetune;
