//! The text protocol of the wrist socket: `GET POS` is answered by `POS 100` and a line's end, `SET POS 100` by `ack`
//! without one. Values mean what the registers mean.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::LinkError;
use super::modbus::connect;
use crate::settings::RobotiqSettings;

/// What is asked for a status, in one go.
const ASKED: [&str; 7] = ["ACT", "GTO", "STA", "OBJ", "FLT", "PRE", "POS"];
/// Longest answer line.
const MOST: usize = 64;

#[derive(Debug)]
pub(super) struct SocketLink {
    stream: TcpStream,
    reply_timeout: Duration,
}

impl SocketLink {
    pub(super) async fn open(address: &str, settings: &RobotiqSettings) -> Result<Self, LinkError> {
        let reply_timeout = Duration::from_millis(settings.reply_timeout_ms);
        Ok(Self { stream: connect(address, reply_timeout).await?, reply_timeout })
    }

    /// The six status bytes, put together from variables; the current is not told.
    pub(super) async fn read(&mut self) -> Result<Vec<u8>, LinkError> {
        let ask: String = ASKED.iter().map(|name| format!("GET {name}\n")).collect();
        let mut came = Vec::new();
        let after = self.reply_timeout;
        let exchange = async {
            self.stream.write_all(ask.as_bytes()).await?;
            let mut byte = [0];
            while came.iter().filter(|b| **b == b'\n').count() < ASKED.len()
                && came.len() < ASKED.len() * MOST
            {
                self.stream.read_exact(&mut byte).await?;
                came.push(byte[0]);
            }
            Ok(())
        };
        finish(timeout(after, exchange).await, after, &came)?;
        socket_status(&came)
    }

    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let line = set_line(bytes);
        let mut came = [0; 3];
        let after = self.reply_timeout;
        let exchange = async {
            self.stream.write_all(line.as_bytes()).await?;
            self.stream.read_exact(&mut came).await.map(|_| ())
        };
        let outcome = timeout(after, exchange).await;
        let known = came.iter().take_while(|b| **b != 0).count();
        finish(outcome, after, &came[..known])?;
        if came == *b"ack" {
            return Ok(());
        }
        let found = format!("{:?}", String::from_utf8_lossy(&came));
        Err(LinkError::Answer { field: "SET".into(), found, expected: "\"ack\"".into() })
    }
}

fn finish(
    outcome: Result<std::io::Result<()>, tokio::time::error::Elapsed>,
    after: Duration,
    came: &[u8],
) -> Result<(), LinkError> {
    match outcome {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) => Err(LinkError::Lost { detail: error.to_string() }),
        Err(_) => Err(LinkError::NoReply { after, bytes: u64::try_from(came.len()).unwrap_or(u64::MAX) }),
    }
}

/// The line that sets what six request bytes say.
fn set_line(bytes: &[u8]) -> String {
    let byte = |i: usize| bytes.get(i).copied().unwrap_or(0);
    let bit = |n: u8| byte(0) >> n & 1;
    format!(
        "SET POS {} SPE {} FOR {} ARD {} ATR {} ACT {} GTO {}\n",
        byte(3),
        byte(4),
        byte(5),
        bit(5),
        bit(4),
        bit(0),
        bit(3)
    )
}

/// The six status bytes of a 2F from the answer lines of a wrist socket, in the order in which they were asked for: `ACT`,
/// `GTO`, `STA`, `OBJ`, `FLT`, `PRE`, `POS`.
///
/// # Errors
/// [`LinkError::Answer`] with the variable, what came and what was expected; [`LinkError::Unavailable`].
pub fn socket_status(came: &[u8]) -> Result<Vec<u8>, LinkError> {
    let mut values = [0u8; ASKED.len()];
    let mut lines = came.split(|b| *b == b'\n');
    for (value, name) in values.iter_mut().zip(ASKED) {
        let line = lines.next().unwrap_or_default();
        let wrong = |expected: String| {
            let found = format!("{:?}", String::from_utf8_lossy(line));
            LinkError::Answer { field: format!("GET {name}"), found, expected }
        };
        let text = str::from_utf8(line).map_err(|_| wrong("text".into()))?;
        let mut words = text.split_ascii_whitespace();
        if words.next() != Some(name) {
            return Err(wrong(format!("{name} and its value")));
        }
        let most = match name {
            "ACT" | "GTO" => 1,
            "STA" | "OBJ" => 3,
            _ => 255,
        };
        *value = match words.next() {
            Some("?") => return Err(LinkError::Unavailable { variable: name.to_owned() }),
            Some(word) => word
                .parse()
                .ok()
                .filter(|v| *v <= most)
                .ok_or_else(|| wrong(format!("{name} and a number from 0 to {most}")))?,
            None => return Err(wrong(format!("{name} and its value"))),
        };
    }
    let [activated, goes, state, object, fault, requested, position] = values;
    Ok(vec![activated | goes << 3 | state << 4 | object << 6, 0, fault, requested, position, 0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn requests_and_answers_are_lines() {
        assert_eq!(
            set_line(&[9, 0, 0, 100, 255, 50]),
            "SET POS 100 SPE 255 FOR 50 ARD 0 ATR 0 ACT 1 GTO 1\n"
        );
        assert_eq!(set_line(&[0; 6]), "SET POS 0 SPE 0 FOR 0 ARD 0 ATR 0 ACT 0 GTO 0\n");
        let answer = b"ACT 1\nGTO 1\nSTA 3\nOBJ 2\nFLT 0\nPRE 255\nPOS 189\n";
        assert_eq!(socket_status(answer).unwrap(), [0xB9, 0, 0, 0xFF, 0xBD, 0]);
    }

    #[test]
    fn what_is_no_answer_is_named() {
        let error = socket_status(b"ACT 1\nGTO ?\n").unwrap_err();
        assert_eq!(error, LinkError::Unavailable { variable: "GTO".into() });
        let error = socket_status(b"ACT 1\nSTA 3\n").unwrap_err().to_string();
        assert_eq!(error, "GET GTO: found \"STA 3\", expected GTO and its value");
        let error = socket_status(b"ACT 1\nGTO 1\nSTA 900\n").unwrap_err().to_string();
        assert_eq!(error, "GET STA: found \"STA 900\", expected STA and a number from 0 to 3");
        assert!(socket_status(b"").is_err());
    }

    proptest! {
        #[test]
        fn no_answer_panics(bytes in proptest::collection::vec(any::<u8>(), 0..200), text in "([A-Z]{3} [0-9?]{1,4}\n){0,8}") {
            let _ = socket_status(&bytes);
            let _ = socket_status(text.as_bytes());
        }
    }
}
