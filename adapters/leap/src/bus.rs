//! Exchanges with the motors on a serial line.
//!
//! A bus is half-duplex: one packet is asked, its answers are awaited, then the next. What came late from an exchange
//! that was given up is thrown away before the next begins.

use std::io;
use std::time::Duration;

use graspd_adapters_dynamixel::table::{self, Register};
use graspd_adapters_dynamixel::{
    Decoder, Event, Instruction, Packet, PacketError, Refusal, Status, fast_sync_blocks,
};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, timeout_at};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

/// Why an exchange failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BusError {
    /// The port cannot be opened.
    #[error("{path}: {detail}")]
    Open {
        /// Path of the port.
        path: String,
        /// What the system said.
        detail: String,
    },
    /// The port broke while it was used.
    #[error("the serial port broke: {detail}")]
    Lost {
        /// What the system said.
        detail: String,
    },
    /// Some motors did not answer in time.
    #[error("no answer from motors {ids:?} within {after:?}; {broken}")]
    NoReply {
        /// Motors that did not.
        ids: Vec<u8>,
        /// Time that each try was given.
        after: Duration,
        /// What came instead.
        broken: Broken,
    },
    /// A motor refused.
    #[error("motor {id}: {register}: {refusal}")]
    Refused {
        /// Its address.
        id: u8,
        /// What was written or read.
        register: &'static str,
        /// Why.
        refusal: Refusal,
    },
    /// A motor answered something else than it was asked.
    #[error("motor {id}: {register}: found {found} bytes, expected {expected}")]
    Length {
        /// Its address.
        id: u8,
        /// What was asked.
        register: &'static str,
        /// Found bytes.
        found: usize,
        /// Expected bytes.
        expected: usize,
    },
    /// What was to be sent is no packet.
    #[error(transparent)]
    Packet(#[from] PacketError),
}

/// What came on a line that was not an answer.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Broken {
    /// Damaged packets.
    pub packets: usize,
    /// The last damage.
    pub last: Option<PacketError>,
    /// Bytes that belong to no packet, or to one that never became whole.
    pub bytes: usize,
}

impl std::fmt::Display for Broken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.last, self.bytes) {
            (Some(last), _) => write!(f, "{} damaged packets, the last: {last}", self.packets),
            (None, 0) => f.write_str("nothing came"),
            (None, bytes) => write!(f, "{bytes} bytes of no whole packet came"),
        }
    }
}

impl BusError {
    /// True when the line itself is gone and must be opened again.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::Lost { .. } | Self::Open { .. })
    }
}

/// What one motor says in answer to a read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Its address.
    pub id: u8,
    /// It has a hardware error.
    pub alert: bool,
    /// Bytes that were read.
    pub data: Vec<u8>,
}

/// A serial line with motors.
#[derive(Debug)]
pub struct Bus {
    port: SerialStream,
    decoder: Decoder,
    reply_timeout: Duration,
    attempts: u32,
    /// True when answers of an exchange that was given up, or not understood, may still come.
    unsettled: bool,
}

impl Bus {
    /// Opens a port. No motor is asked anything yet.
    ///
    /// # Errors
    /// [`BusError::Open`].
    pub async fn open(
        path: &str,
        baud: u32,
        reply_timeout: Duration,
        attempts: u32,
    ) -> Result<Self, BusError> {
        let wrong = |detail: String| BusError::Open { path: path.to_owned(), detail };
        let builder = tokio_serial::new(path, baud);
        // Opening may wait for a device's driver.
        let opened = tokio::task::spawn_blocking(move || SerialStream::open(&builder)).await;
        let port = opened.map_err(|e| wrong(e.to_string()))?.map_err(|e| wrong(e.to_string()))?;
        Ok(Self { port, decoder: Decoder::new(), reply_timeout, attempts: attempts.max(1), unsettled: false })
    }

    /// Model number and firmware of a motor.
    ///
    /// # Errors
    /// Any [`BusError`].
    pub async fn ping(&mut self, id: u8) -> Result<(u16, u8), BusError> {
        let answer = self.one(id, &Instruction::Ping, "Ping", self.attempts).await?;
        let [low, high, firmware] = exact(id, "Ping", &answer.data)?;
        Ok((u16::from_le_bytes([low, high]), firmware))
    }

    /// True when a motor answers; it is asked once.
    ///
    /// # Errors
    /// [`BusError::Lost`].
    pub async fn answers(&mut self, id: u8) -> Result<bool, BusError> {
        match self.one(id, &Instruction::Ping, "Ping", 1).await {
            Ok(_) => Ok(true),
            Err(error) if error.is_lost() => Err(error),
            Err(_) => Ok(false),
        }
    }

    /// Writes a register of one motor, which confirms it.
    ///
    /// # Errors
    /// Any [`BusError`]; [`BusError::Refused`] with the motor's reason.
    pub async fn write(&mut self, id: u8, register: Register, value: i32) -> Result<(), BusError> {
        let data = bytes_of(register, value);
        let instruction = Instruction::Write { addr: register.addr, data };
        self.one(id, &instruction, register.name, self.attempts).await.map(|_| ())
    }

    /// Starts a motor anew; it confirms and is away for a while.
    ///
    /// # Errors
    /// Any [`BusError`].
    pub async fn reboot(&mut self, id: u8) -> Result<(), BusError> {
        // Asked once: a confirmation that was lost is one of a motor that boots.
        self.one(id, &Instruction::Reboot, "Reboot", 1).await.map(|_| ())
    }

    /// Reads registers of one motor.
    ///
    /// # Errors
    /// Any [`BusError`].
    pub async fn read(&mut self, id: u8, register: Register) -> Result<Answer, BusError> {
        let instruction = Instruction::Read { addr: register.addr, len: register.len };
        let expected = usize::from(register.len);
        let mut tries = 0;
        loop {
            tries += 1;
            let answer = self.one(id, &instruction, register.name, self.attempts).await?;
            let found = answer.data.len();
            if found == expected {
                return Ok(answer);
            }
            // Most likely the answer to an earlier question.
            self.unsettled = true;
            if tries >= self.attempts {
                return Err(BusError::Length { id, register: register.name, found, expected });
            }
        }
    }

    /// Writes a register of many motors at once. Nobody confirms it.
    ///
    /// # Errors
    /// [`BusError::Lost`].
    pub async fn sync_write(
        &mut self,
        register: Register,
        values: impl Iterator<Item = (u8, i32)>,
    ) -> Result<(), BusError> {
        let blocks = values.map(|(id, value)| (id, bytes_of(register, value))).collect();
        let instruction = Instruction::SyncWrite { addr: register.addr, len: register.len, blocks };
        let bytes = instruction.to_packet(0)?.encode()?;
        self.send(&bytes).await
    }

    /// Reads the same registers of many motors in one exchange, answers in the order of `ids`.
    ///
    /// # Errors
    /// [`BusError::NoReply`] with those that did not answer; any other [`BusError`].
    pub async fn sync_read(
        &mut self,
        register: Register,
        ids: &[u8],
        fast: bool,
    ) -> Result<Vec<Answer>, BusError> {
        let (addr, len, ids) = (register.addr, register.len, ids.to_vec());
        let instruction = if fast && ids.len() > 1 {
            Instruction::FastSyncRead { addr, len, ids: ids.clone() }
        } else {
            Instruction::SyncRead { addr, len, ids: ids.clone() }
        };
        let bytes = instruction.to_packet(0)?.encode()?;
        let fast = matches!(instruction, Instruction::FastSyncRead { .. });
        let len = usize::from(len);
        let mut last =
            BusError::NoReply { ids: ids.clone(), after: self.reply_timeout, broken: Broken::default() };
        for _ in 0..self.attempts {
            let tried =
                if fast { self.ask_together(&bytes, &ids, len).await } else { self.ask(&bytes, &ids).await };
            let checked = tried.and_then(|answers| {
                answers.into_iter().map(|s| checked(s, register.name, len)).collect::<Result<Vec<_>, _>>()
            });
            match checked {
                Ok(answers) => return Ok(answers),
                Err(error) if error.is_lost() || matches!(error, BusError::Refused { .. }) => {
                    return Err(error);
                }
                Err(error) => {
                    // An answer of another length is most likely one to an earlier question.
                    self.unsettled = true;
                    last = error;
                }
            }
        }
        Err(last)
    }

    /// One motor's answer to one instruction.
    async fn one(
        &mut self,
        id: u8,
        instruction: &Instruction,
        register: &'static str,
        attempts: u32,
    ) -> Result<Answer, BusError> {
        let bytes = instruction.to_packet(id)?.encode()?;
        let mut tries = 0;
        loop {
            tries += 1;
            match self.ask(&bytes, &[id]).await {
                Ok(mut answers) => {
                    let Some(status) = answers.pop() else {
                        return Err(BusError::Length { id, register, found: 0, expected: 1 });
                    };
                    // A motor that got the packet garbled may be told again.
                    if status.error.refusal == Some(Refusal::Crc) && tries < attempts {
                        continue;
                    }
                    return match status.error.refusal {
                        Some(refusal) => Err(BusError::Refused { id, register, refusal }),
                        None => Ok(Answer { id, alert: status.error.alert, data: status.data }),
                    };
                }
                Err(error) if error.is_lost() || tries >= attempts => return Err(error),
                Err(_) => {}
            }
        }
    }

    /// Waits until the line is quiet: an answer does not say what it answers, so one that comes late would be taken for
    /// the answer to what is asked next. Ends within a few times of a reply.
    async fn settle(&mut self) -> Result<(), BusError> {
        let end = Instant::now() + 4 * self.reply_timeout;
        let mut buffer = [0u8; 1024];
        loop {
            let quiet = (Instant::now() + self.reply_timeout).min(end);
            match timeout_at(quiet, self.port.read(&mut buffer)).await {
                Ok(Ok(0)) => return Err(BusError::Lost { detail: "it hung up".into() }),
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return Err(lost(error)),
                Err(_) => break,
            }
        }
        self.unsettled = false;
        Ok(())
    }

    /// Sends a packet, first throwing away what came late.
    async fn send(&mut self, bytes: &[u8]) -> Result<(), BusError> {
        if self.unsettled {
            self.settle().await?;
        }
        self.decoder.clear();
        self.port.clear(ClearBuffer::Input).map_err(|e| BusError::Lost { detail: e.to_string() })?;
        let deadline = Instant::now() + self.reply_timeout.max(Duration::from_millis(100));
        match timeout_at(deadline, self.port.write_all(bytes)).await {
            Ok(sent) => sent.map_err(lost),
            Err(_) => Err(BusError::Lost { detail: "it takes no more bytes".into() }),
        }
    }

    /// Asks, and waits for one answer of each motor, in this order.
    async fn ask(&mut self, bytes: &[u8], ids: &[u8]) -> Result<Vec<Status>, BusError> {
        self.send(bytes).await?;
        let mut found: Vec<Option<Status>> = vec![None; ids.len()];
        let complete = |packet: Packet| {
            // Some converters hear themselves: what was sent comes back first, and is no answer.
            if let Ok(status) = Status::from_packet(&packet)
                && let Some(at) = ids.iter().position(|id| *id == status.id)
            {
                found[at] = Some(status);
            }
            found.iter().all(Option::is_some)
        };
        let outcome = self.listen(complete).await?;
        if let Some(broken) = outcome {
            let missing = ids.iter().zip(&found).filter(|(_, s)| s.is_none()).map(|(id, _)| *id).collect();
            return Err(BusError::NoReply { ids: missing, after: self.reply_timeout, broken });
        }
        Ok(found.into_iter().flatten().collect())
    }

    /// Asks, and waits for the one answer that all motors write together.
    async fn ask_together(&mut self, bytes: &[u8], ids: &[u8], len: usize) -> Result<Vec<Status>, BusError> {
        self.send(bytes).await?;
        let mut found = None;
        let mut damage = None;
        let complete = |packet: Packet| {
            match fast_sync_blocks(&packet, len) {
                Ok(blocks) if blocks.iter().map(|b| b.id).eq(ids.iter().copied()) => found = Some(blocks),
                Ok(_) => {}
                Err(PacketError::Instruction { .. }) => {}
                Err(error) => damage = Some(error),
            }
            found.is_some()
        };
        let outcome = self.listen(complete).await?;
        if let Some(mut broken) = outcome {
            broken.packets += usize::from(damage.is_some());
            broken.last = damage.or(broken.last);
            return Err(BusError::NoReply { ids: ids.to_vec(), after: self.reply_timeout, broken });
        }
        let blocks = found.unwrap_or_default();
        Ok(blocks.into_iter().map(|b| Status { id: b.id, error: b.error, data: b.data }).collect())
    }

    /// Hands packets to `complete` until it says so: `None`; or until time is up: what came that was none.
    async fn listen(&mut self, mut complete: impl FnMut(Packet) -> bool) -> Result<Option<Broken>, BusError> {
        let deadline = Instant::now() + self.reply_timeout;
        let mut broken = Broken::default();
        let mut buffer = [0u8; 1024];
        loop {
            while let Some(event) = self.decoder.next_event() {
                match event {
                    Event::Packet(packet) => {
                        if complete(packet) {
                            return Ok(None);
                        }
                    }
                    Event::Broken(error) => {
                        broken.packets += 1;
                        broken.last = Some(error);
                    }
                    Event::Skipped(bytes) => broken.bytes += bytes,
                }
            }
            match timeout_at(deadline, self.port.read(&mut buffer)).await {
                Ok(Ok(0)) => return Err(BusError::Lost { detail: "it hung up".into() }),
                Ok(Ok(n)) => self.decoder.push(&buffer[..n]),
                Ok(Err(error)) => return Err(lost(error)),
                Err(_) => {
                    broken.bytes += self.decoder.pending();
                    self.unsettled = true;
                    return Ok(Some(broken));
                }
            }
        }
    }
}

fn lost(error: io::Error) -> BusError {
    BusError::Lost { detail: error.to_string() }
}

/// The lowest bytes of a value, as many as the register has.
fn bytes_of(register: Register, value: i32) -> Vec<u8> {
    let bytes = value.to_le_bytes();
    bytes[..usize::from(register.len).min(bytes.len())].to_vec()
}

fn checked(status: Status, register: &'static str, expected: usize) -> Result<Answer, BusError> {
    let (id, found) = (status.id, status.data.len());
    match status.error.refusal {
        Some(refusal) => Err(BusError::Refused { id, register, refusal }),
        None if found != expected => Err(BusError::Length { id, register, found, expected }),
        None => Ok(Answer { id, alert: status.error.alert, data: status.data }),
    }
}

fn exact<const N: usize>(id: u8, register: &'static str, data: &[u8]) -> Result<[u8; N], BusError> {
    data.try_into().map_err(|_| BusError::Length { id, register, found: data.len(), expected: N })
}

/// Current, speed and position of a motor, which lie side by side: one read of ten bytes.
pub const FEEDBACK: Register = Register {
    addr: table::PRESENT_CURRENT.addr,
    len: table::PRESENT_POSITION.addr + table::PRESENT_POSITION.len - table::PRESENT_CURRENT.addr,
    name: "Present Current to Present Position",
};

/// Voltage and temperature of a motor: one read of three bytes.
pub const SUPPLY: Register = Register {
    addr: table::PRESENT_VOLTAGE.addr,
    len: 3,
    name: "Present Input Voltage to Present Temperature",
};
