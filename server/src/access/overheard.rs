//! The beginning of a message that passes by: enough to know what it is about. What passes is not held up or changed.

use std::{
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll},
};

use bytes::Bytes;
use http_body::{Frame, SizeHint};
use tonic::{Status, body::Body};

/// Most that is kept of a message. Names and ids stand before anything large.
const MOST: usize = 64 << 10;
/// Whether it is compressed, and its length in four bytes.
const PREFIX: usize = 5;

/// The beginning of a body's first message.
#[derive(Debug, Default)]
pub(super) struct Head(Vec<u8>);

impl Head {
    /// Takes in the next bytes of the body.
    pub(super) fn hear(&mut self, data: &[u8]) {
        let missing = self.wanted().saturating_sub(self.0.len());
        self.0.extend_from_slice(&data[..missing.min(data.len())]);
    }

    /// The first message, as far as it was heard.
    pub(super) fn message(&self) -> &[u8] {
        match self.0.split_at_checked(PREFIX) {
            // A compressed one cannot be read; nobody is told that they may be sent.
            Some(([0, ..], message)) => message.get(..self.wanted() - PREFIX).unwrap_or(message),
            Some(_) | None => &[],
        }
    }

    fn wanted(&self) -> usize {
        match self.0.first_chunk::<PREFIX>() {
            Some([_, length @ ..]) => {
                usize::try_from(u32::from_be_bytes(*length)).map_or(MOST, |length| MOST.min(PREFIX + length))
            }
            None => MOST,
        }
    }
}

/// A request's body, overheard.
pub(super) struct Overheard {
    body: Body,
    head: Arc<Mutex<Head>>,
}

impl Overheard {
    pub(super) fn new(body: Body, head: Arc<Mutex<Head>>) -> Self {
        Self { body, head }
    }
}

impl http_body::Body for Overheard {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let frame = Pin::new(&mut self.body).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &frame
            && let Some(data) = frame.data_ref()
        {
            self.head.lock().unwrap_or_else(PoisonError::into_inner).hear(data);
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn framed(message: &[u8]) -> Vec<u8> {
        let length = u32::try_from(message.len()).unwrap().to_be_bytes();
        [&[0], length.as_slice(), message].concat()
    }

    #[test]
    fn the_first_message_is_heard_however_it_comes() {
        let body = [framed(b"first"), framed(b"second")].concat();
        for size in [1, 3, 100] {
            let mut head = Head::default();
            body.chunks(size).for_each(|chunk| head.hear(chunk));
            assert_eq!(head.message(), b"first");
        }
    }

    #[test]
    fn little_is_kept_of_much() {
        let mut head = Head::default();
        let body = framed(&vec![7; 4 << 20]);
        body.chunks(16 << 10).for_each(|chunk| head.hear(chunk));
        assert!(head.message().len() < MOST && head.0.capacity() <= 2 * MOST);
    }

    #[test]
    fn what_is_no_message_says_nothing() {
        for bytes in [&b""[..], b"\0\0\0", b"\x01\0\0\0\x02hi"] {
            let mut head = Head::default();
            head.hear(bytes);
            assert!(head.message().is_empty(), "{bytes:?}");
        }
    }
}
