//! Step three of SSDF: policies. One policy, one file; here is what runs them.

mod ensemble;
mod finetune;
mod history;
mod serve;

pub use ensemble::Ensemble;
pub use finetune::train_policy;
pub use history::{Embedding, History};
pub use serve::Policy;
