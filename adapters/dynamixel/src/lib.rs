//! Dynamixel protocol 2.0 without any I/O: packets, byte stuffing, CRC, status answers, control tables.
//!
//! One codec for both ends of a bus: a client turns an [`Instruction`] into bytes and reads [`Status`] packets, a
//! device reads instructions and answers. A [`Decoder`] takes a stream of bytes in whatever pieces it comes, finds
//! packets in it and says what it had to skip.
//!
//! Source of every format: the manufacturer's protocol 2.0 manual; of registers: the control tables of the X330 series.

mod crc;
mod decode;
mod error;
mod fast;
mod instruction;
mod packet;
mod status;
mod stuffing;
pub mod table;

pub use crc::{crc16, crc16_more};
pub use decode::{Decoder, Event};
pub use error::PacketError;
pub use fast::{FastBlock, encode_fast_sync, fast_sync_blocks, fast_sync_len};
pub use instruction::{Instruction, code};
pub use packet::{BROADCAST, HEADER, MAX_ID, MAX_PACKET, Packet};
pub use status::{Refusal, Status, StatusError};
pub use stuffing::{stuff, unstuff};
