//! Step three of SSDF: policies. One policy, one file, and its line in [`list`]; the rest here
//! trains and runs them without knowing which they are.

mod act;
mod bc;
mod ensemble;
mod finetune;
mod kind;
mod list;
mod scratch;
mod serve;
mod tf_bc;
mod train;

pub use ensemble::Ensemble;
pub(crate) use list::describe;
pub use serve::Policy;
pub use train::train_policy;

#[cfg(test)]
mod tests;
