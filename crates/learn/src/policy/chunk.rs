//! The settings of policies that predict chunks of actions.

use gleaner_core::Words as _;
use gleaner_core::schema::integer_in;

gleaner_core::words! {
    /// The network that predicts a chunk from an encoded observation.
    pub(super) enum ChunkNetwork {
        /// A transformer with a token for the images, one for proprioception and one for each place of the chunk, as in
        /// the papers. It needs long trainings before it looks at the images.
        Transformer = "transformer",
        /// A perceptron of all numbers at once, like that of behaviour cloning, in which proprioception is as many values
        /// as it has. It learns from short trainings, and is faster.
        Perceptron = "perceptron",
    }
}

gleaner_core::settings! {
    /// The chunk that a policy predicts, and the part of it that is executed.
    #[derive(Copy)]
    pub(super) struct ChunkSpec {
        /// Number of actions predicted at once (k). Longer chunks are smoother and react later.
        pub(super) chunk_length: u32 = 5, integer_in(1, 256);
        /// Number of actions executed of each chunk before the next one is predicted; at most chunk_length. Larger
        /// numbers cost less and react later.
        pub(super) execute_length: u32 = 2, integer_in(1, 256);
        /// Network that predicts a chunk.
        pub(super) chunk_network: ChunkNetwork = ChunkNetwork::Perceptron, ChunkNetwork::shape();
    }
}

impl ChunkSpec {
    /// Actions executed of each chunk before the next is predicted.
    pub(super) fn horizon(self) -> u32 {
        self.execute_length.min(self.chunk_length)
    }
}
