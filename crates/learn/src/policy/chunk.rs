//! The settings of policies that predict chunks of actions.

use gleaner_core::schema::integer_in;

gleaner_core::settings! {
    /// The chunk that a policy predicts.
    #[derive(Copy)]
    pub(super) struct ChunkSpec {
        /// Number of actions predicted at once (k). Longer chunks are smoother and react later.
        pub(super) chunk_length: u32 = 10, integer_in(1, 256);
    }
}
