//! A connection that ends when its client takes an answer too slowly.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Sleep;

use crate::Pace;

/// A stream whose writes fail once its reader is slower than its [`Pace`].
#[derive(Debug)]
pub(crate) struct Paced<T> {
    stream: T,
    pace: Pace,
    /// Start of the present wait for the client.
    waiting: Option<Instant>,
    /// Fires when a write has waited too long.
    alarm: Pin<Box<Sleep>>,
    /// Time for which writes have waited since the rate was last compared, and bytes that the client read in it.
    waited: Duration,
    taken: u64,
}

impl<T> Paced<T> {
    pub fn new(stream: T, pace: Pace) -> Self {
        let alarm = Box::pin(tokio::time::sleep(pace.silence));
        Self { stream, pace, waiting: None, alarm, waited: Duration::ZERO, taken: 0 }
    }

    fn judge(&mut self, context: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        let slow = |what| Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, what)));
        let Poll::Ready(written) = written else {
            if self.waiting.is_none() {
                self.waiting = Some(Instant::now());
                self.alarm.as_mut().reset(tokio::time::Instant::now() + self.pace.silence);
                if self.waited.is_zero() {
                    // Bytes that were sent without waiting do not count.
                    self.taken = 0;
                }
            }
            ready!(self.alarm.as_mut().poll(context));
            return slow("the client read nothing for too long");
        };
        let written = written?;
        self.taken += written as u64;
        if let Some(since) = self.waiting.take() {
            self.waited += since.elapsed();
            if self.waited > self.pace.start {
                if (self.taken as f64) < self.pace.min_rate as f64 * self.waited.as_secs_f64() {
                    return slow("the client reads more slowly than the lowest rate");
                }
                (self.waited, self.taken) = (Duration::ZERO, 0);
            }
        }
        Poll::Ready(Ok(written))
    }
}

impl<T: AsyncRead + Unpin> AsyncRead for Paced<T> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, into)
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for Paced<T> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.judge(context, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        self.judge(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    use super::*;

    const BYTES: usize = 100_000;

    /// Writes to a reader that takes `part` bytes every 10 ms.
    async fn written(part: usize) -> io::Result<()> {
        let (ours, mut theirs) = tokio::io::duplex(1000);
        let pace = Pace { silence: Duration::from_millis(200), start: Duration::from_millis(300), min_rate: 20_000 };
        let reader = tokio::spawn(async move {
            let mut buffer = vec![0; part.max(1)];
            while part > 0 && theirs.read(&mut buffer).await.unwrap_or(0) > 0 {
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            std::future::pending::<()>().await;
        });
        let done = Paced::new(ours, pace).write_all(&[7; BYTES]).await;
        reader.abort();
        done
    }

    /// Guards against clients that read nothing, or so slowly that an answer would never end.
    #[tokio::test]
    async fn a_slow_reader_is_cut_and_a_fast_one_is_not() {
        written(BYTES).await.unwrap();
        let silent = written(0).await.unwrap_err();
        assert!(silent.to_string().contains("read nothing"), "{silent}");
        let slow = written(20).await.unwrap_err();
        assert!(slow.to_string().contains("lowest rate"), "{slow}");
    }
}
