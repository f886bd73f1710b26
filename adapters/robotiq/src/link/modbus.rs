//! Modbus: RTU on a serial port, RTU over TCP, TCP.

use std::borrow::Cow;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_modbus::client::{Client, Context, rtu, tcp};
use tokio_modbus::{Error, Request, Response, Slave};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

use super::LinkError;
use super::counted::{Count, Counted};
use crate::settings::{LinkSettings, RobotiqSettings};

pub(super) struct ModbusLink {
    context: Context,
    count: Count,
    reply_timeout: Duration,
    reads_from: u16,
    writes_from: u16,
    registers: u16,
    input_registers: bool,
}

impl std::fmt::Debug for ModbusLink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ModbusLink").field("reads_from", &self.reads_from).finish_non_exhaustive()
    }
}

impl ModbusLink {
    pub(super) async fn open(settings: &RobotiqSettings) -> Result<Self, LinkError> {
        let reply_timeout = Duration::from_millis(settings.reply_timeout_ms);
        Ok(match &settings.link {
            LinkSettings::Rtu { port, baud } => Self::attach(serial(port, *baud).await?, settings),
            LinkSettings::RtuOverTcp { address }
            | LinkSettings::ModbusTcp { address }
            | LinkSettings::Socket { address } => {
                Self::attach(connect(address, reply_timeout).await?, settings)
            }
        })
    }

    /// Over a stream that is open already.
    pub(super) fn attach<T>(stream: T, settings: &RobotiqSettings) -> Self
    where
        T: AsyncRead + AsyncWrite + std::fmt::Debug + Unpin + Send + 'static,
    {
        let (slave, count) = (Slave(settings.slave), Count::default());
        let stream = Counted::new(stream, count.clone());
        let context = match &settings.link {
            LinkSettings::Rtu { .. } | LinkSettings::RtuOverTcp { .. } => rtu::attach_slave(stream, slave),
            LinkSettings::ModbusTcp { .. } | LinkSettings::Socket { .. } => tcp::attach_slave(stream, slave),
        };
        let [reads_from, writes_from] = settings.first_registers();
        // At most eight registers.
        let registers = u16::try_from(settings.model.bytes() / 2).unwrap_or(8);
        let input_registers = settings.reads_input_registers();
        let reply_timeout = Duration::from_millis(settings.reply_timeout_ms);
        Self { context, count, reply_timeout, reads_from, writes_from, registers, input_registers }
    }

    #[cfg(test)]
    fn over(context: Context, registers: u16) -> Self {
        let (count, reply_timeout) = (Count::default(), Duration::from_millis(200));
        Self {
            context,
            count,
            reply_timeout,
            reads_from: 2000,
            writes_from: 1000,
            registers,
            input_registers: false,
        }
    }

    pub(super) async fn read(&mut self) -> Result<Vec<u8>, LinkError> {
        let (first, count) = (self.reads_from, self.registers);
        let request = if self.input_registers {
            Request::ReadInputRegisters(first, count)
        } else {
            Request::ReadHoldingRegisters(first, count)
        };
        let words = match self.call(first, request).await? {
            Response::ReadInputRegisters(words) | Response::ReadHoldingRegisters(words) => words,
            other => return Err(unexpected(first, format!("{other:?}"), "registers")),
        };
        if words.len() != usize::from(count) {
            return Err(unexpected(first, format!("{} registers", words.len()), &count.to_string()));
        }
        Ok(words.into_iter().flat_map(u16::to_be_bytes).collect())
    }

    pub(super) async fn write(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let first = self.writes_from;
        let words: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
        let expected = u16::try_from(words.len()).unwrap_or(u16::MAX);
        let request = Request::WriteMultipleRegisters(first, Cow::Owned(words));
        match self.call(first, request).await? {
            Response::WriteMultipleRegisters(at, count) if (at, count) == (first, expected) => Ok(()),
            other => Err(unexpected(first, format!("{other:?}"), &format!("{expected} registers written"))),
        }
    }

    /// One exchange. Whoever gives up an exchange must open the link anew: an answer may still come.
    async fn call(&mut self, first: u16, request: Request<'_>) -> Result<Response, LinkError> {
        self.count.request_follows();
        let before = self.count.get();
        let after = self.reply_timeout;
        let Ok(answer) = timeout(after, self.context.call(request)).await else {
            return Err(LinkError::NoReply { after, bytes: self.count.get() - before });
        };
        match answer {
            Ok(Ok(response)) => Ok(response),
            Ok(Err(exception)) => Err(LinkError::Refused { first, exception: exception.to_string() }),
            Err(Error::Transport(error)) if error.kind() == io::ErrorKind::InvalidData => {
                Err(unexpected(first, error.to_string(), "a frame"))
            }
            Err(Error::Transport(error)) => Err(LinkError::Lost { detail: error.to_string() }),
            Err(Error::Protocol(error)) => {
                Err(unexpected(first, error.to_string(), "the answer to this request"))
            }
        }
    }
}

fn unexpected(first: u16, found: String, expected: &str) -> LinkError {
    LinkError::Answer { field: format!("registers {first} and on"), found, expected: expected.to_owned() }
}

async fn serial(port: &str, baud: u32) -> Result<SerialStream, LinkError> {
    let wrong = |detail: String| LinkError::Open { place: port.to_owned(), detail };
    let builder = tokio_serial::new(port, baud);
    // Opening may wait for a device's driver.
    let opened = tokio::task::spawn_blocking(move || SerialStream::open(&builder)).await;
    let stream = opened.map_err(|e| wrong(e.to_string()))?.map_err(|e| wrong(e.to_string()))?;
    // What came before is no answer to us.
    stream.clear(ClearBuffer::Input).map_err(|e| wrong(e.to_string()))?;
    Ok(stream)
}

pub(super) async fn connect(address: &str, within: Duration) -> Result<TcpStream, LinkError> {
    let wrong = |detail: String| LinkError::Open { place: address.to_owned(), detail };
    // Looking up a name and a handshake take longer than an answer.
    let within = within.max(Duration::from_secs(1));
    let connected = timeout(within, TcpStream::connect(address)).await;
    let stream = connected
        .map_err(|_| wrong(format!("no connection within {within:?}")))?
        .map_err(|e| wrong(e.to_string()))?;
    // Requests are short and awaited; a system that cannot say so is only slower.
    let _slower = stream.set_nodelay(true);
    Ok(stream)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    /// Bytes as they are printed in manuals.
    fn hex(text: &str) -> Vec<u8> {
        text.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
    }

    /// A link, and a slave that expects these bytes and answers those.
    fn link_to(exchanges: &[(&str, &str)], registers: u16) -> ModbusLink {
        let (ours, mut theirs) = tokio::io::duplex(512);
        let exchanges: Vec<_> = exchanges.iter().map(|(ask, answer)| (hex(ask), hex(answer))).collect();
        tokio::spawn(async move {
            for (ask, answer) in exchanges {
                let mut found = vec![0; ask.len()];
                theirs.read_exact(&mut found).await.unwrap();
                assert_eq!(found, ask);
                theirs.write_all(&answer).await.unwrap();
            }
            // Open until the other side is done.
            let _closed = theirs.read_u8().await;
        });
        ModbusLink::over(rtu::attach_slave(ours, Slave(9)), registers)
    }

    #[tokio::test]
    async fn exchanges_are_the_published_frames() {
        let written = "09 10 03 E8 00 03 01 30";
        let mut link = link_to(
            &[
                ("09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30", written),
                ("09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1", written),
                ("09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29", written),
                ("09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19", written),
                ("09 03 07 D0 00 03 04 0E", "09 03 06 39 00 00 FF 0E 0A F7 8B"),
                ("09 03 07 D0 00 03 04 0E", "09 03 06 B9 00 00 FF BD 00 1D 7C"),
            ],
            3,
        );
        link.write(&[0; 6]).await.unwrap();
        link.write(&[1, 0, 0, 0, 0, 0]).await.unwrap();
        link.write(&[9, 0, 0, 0xFF, 0xFF, 0xFF]).await.unwrap();
        link.write(&[9, 0, 0, 0, 0xFF, 0xFF]).await.unwrap();
        assert_eq!(link.read().await.unwrap(), [0x39, 0, 0, 0xFF, 0x0E, 0x0A]);
        assert_eq!(link.read().await.unwrap(), [0xB9, 0, 0, 0xFF, 0xBD, 0]);
    }

    #[tokio::test]
    async fn status_is_also_read_with_function_code_4_as_published() {
        let mut link = link_to(&[("09 04 07 D0 00 03 B1 CE", "09 04 06 B9 00 00 FF BD 00 5C 9A")], 3);
        link.input_registers = true;
        assert_eq!(link.read().await.unwrap(), [0xB9, 0, 0, 0xFF, 0xBD, 0]);
    }

    /// A 3-Finger on Modbus TCP: registers from 0, read with function code 4, written with 16.
    #[tokio::test]
    async fn modbus_tcp_frames_are_those_of_a_three_finger_controller() {
        let (ours, mut theirs) = tokio::io::duplex(512);
        let address = "127.0.0.1:502".to_owned();
        let link = LinkSettings::ModbusTcp { address };
        let settings =
            RobotiqSettings { model: crate::Model::ThreeFinger, link, ..RobotiqSettings::default() };
        let ([reads_from, writes_from], input_registers) =
            (settings.first_registers(), settings.reads_input_registers());
        let mut link = ModbusLink {
            reads_from,
            writes_from,
            input_registers,
            ..ModbusLink::over(tcp::attach_slave(ours, Slave(9)), 8)
        };
        let request = [0x0B, 0x0C, 0, 10, 11, 12, 20, 21, 22, 30, 31, 32, 40, 41, 42, 0];
        let status = [0x39, 0xAA, 0, 10, 9, 1, 20, 19, 2, 30, 29, 3, 40, 39, 4, 0];
        let slave = tokio::spawn(async move {
            // After the transaction's number: protocol 0, length, unit 9.
            for (ask, answer) in [
                (
                    "00 00 00 17 09 10 00 00 00 08 10 0B 0C 00 0A 0B 0C 14 15 16 1E 1F 20 28 29 2A 00",
                    "00 00 00 06 09 10 00 00 00 08",
                ),
                (
                    "00 00 00 06 09 04 00 00 00 08",
                    "00 00 00 13 09 04 10 39 AA 00 0A 09 01 14 13 02 1E 1D 03 28 27 04 00",
                ),
            ] {
                let mut found = vec![0; hex(ask).len() + 2];
                theirs.read_exact(&mut found).await.unwrap();
                assert_eq!(found[2..], hex(ask));
                theirs.write_all(&[&found[..2], &hex(answer)].concat()).await.unwrap();
            }
        });
        link.write(&request).await.unwrap();
        assert_eq!(link.read().await.unwrap(), status);
        slave.await.unwrap();
    }

    #[tokio::test]
    async fn what_is_no_answer_is_an_error_that_says_so() {
        let poll = "09 03 07 D0 00 01 85 CF";
        let mut link = link_to(&[(poll, "09 83 02 41 33")], 1);
        let error = link.read().await.unwrap_err();
        assert!(matches!(error, LinkError::Refused { first: 2000, .. }), "{error}");
        // A wrong check: never taken for a status.
        let mut link = link_to(&[(poll, "09 03 02 31 00 4C 16")], 1);
        let error = link.read().await.unwrap_err();
        assert!(matches!(error, LinkError::NoReply { .. } | LinkError::Answer { .. }), "{error}");
        // Another slave, and more registers than were asked for.
        let mut link = link_to(&[(poll, "08 03 02 31 00 71 C5")], 1);
        assert!(link.read().await.is_err());
        let mut link = link_to(&[(poll, "09 03 06 B9 00 00 FF BD 00 1D 7C")], 1);
        let error = link.read().await.unwrap_err().to_string();
        assert_eq!(error, "registers 2000 and on: found 3 registers, expected 1");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_answer_panics(bytes in proptest::collection::vec(any::<u8>(), 1..60)) {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
            runtime.block_on(async {
                let (ours, mut theirs) = tokio::io::duplex(512);
                theirs.write_all(&bytes).await.unwrap();
                drop(theirs);
                let mut link = ModbusLink::over(rtu::attach_slave(ours, Slave(9)), 3);
                link.reply_timeout = Duration::from_millis(5);
                assert!(link.read().await.is_err());
            });
        }
    }
}
