//! What the three codecs have in common for a stream.

use crate::error::VideoError;
use crate::picture::Picture;

/// A picture, and the message that holds it.
pub(crate) type Decoded = (usize, Picture);

/// A decoder of one codec. Pictures may come out later than their message, up to the next [`Decoder::flush`].
pub(crate) trait Decoder {
    /// Decodes a message that is a part of the sequence since the last key frame or flush.
    fn push(&mut self, message: usize, data: &[u8], out: &mut Vec<Decoded>) -> Result<(), VideoError>;

    /// Stores the parameter sets of a message whose picture is not decoded.
    fn parameters(&mut self, data: &[u8]);

    /// Returns every picture that is still inside. The next message with a picture is a key frame.
    fn flush(&mut self, out: &mut Vec<Decoded>);
}
