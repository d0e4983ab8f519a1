//! Step three of SSDF: policies. One policy, one file, and its line in [`method`]; the rest here
//! trains and runs them without knowing which they are.

mod act;
mod bc;
mod ensemble;
mod finetune;
mod method;
mod scratch;
mod serve;
mod tf_bc;
mod train;

pub use ensemble::Ensemble;
pub use serve::Policy;
pub use train::train_policy;

#[cfg(test)]
mod tests;
