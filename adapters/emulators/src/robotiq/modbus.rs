//! Modbus requests on a gripper's registers. Registers hold two bytes each, the first in the high half.

use std::time::Instant;

use super::device::Gripper;

/// First register that is written, and first that is read.
const OUTPUTS: u16 = 1000;
const INPUTS: u16 = 2000;
/// Registers of each.
const COUNT: u16 = 8;

/// Exception codes.
const ILLEGAL_FUNCTION: u8 = 1;
const ILLEGAL_ADDRESS: u8 = 2;
const ILLEGAL_VALUE: u8 = 3;

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]))
}

/// The answer to a request: function code and what follows it. `from_zero`: registers also begin at 0, as in Modbus TCP
/// controllers.
pub(super) fn answer(gripper: &Gripper, request: &[u8], from_zero: bool, now: Instant) -> Vec<u8> {
    let Some(function) = request.first().copied() else { return Vec::new() };
    match obey(gripper, function, &request[1..], from_zero, now) {
        Ok(mut answer) => {
            answer.insert(0, function);
            answer
        }
        Err(code) => vec![function | 0x80, code],
    }
}

fn obey(gripper: &Gripper, function: u8, rest: &[u8], from_zero: bool, now: Instant) -> Result<Vec<u8>, u8> {
    let field = |at: usize| word(rest, at).ok_or(ILLEGAL_VALUE);
    let registers = Registers { gripper, from_zero, now };
    match function {
        3 | 4 => registers.read(field(0)?, field(2)?, function),
        6 => {
            registers.write(field(0)?, &rest[2..4])?;
            Ok(rest[..4].to_vec())
        }
        16 => {
            let (at, count) = (field(0)?, field(2)?);
            let data = block(rest, 4, count)?;
            registers.write(at, data)?;
            Ok(rest[..4].to_vec())
        }
        23 => {
            let (read_at, read_count, at, count) = (field(0)?, field(2)?, field(4)?, field(6)?);
            let data = block(rest, 8, count)?;
            // The write comes first; an impossible read must not leave it done.
            registers.place(read_at, read_count, function)?;
            registers.write(at, data)?;
            registers.read(read_at, read_count, function)
        }
        _ => Err(ILLEGAL_FUNCTION),
    }
}

/// `count` registers of data, after a byte that says how many bytes they are.
fn block(rest: &[u8], at: usize, count: u16) -> Result<&[u8], u8> {
    let said = usize::from(*rest.get(at).ok_or(ILLEGAL_VALUE)?);
    let data = rest.get(at + 1..).ok_or(ILLEGAL_VALUE)?;
    if said != 2 * usize::from(count) || data.len() != said || count == 0 {
        Err(ILLEGAL_VALUE)
    } else {
        Ok(data)
    }
}

struct Registers<'a> {
    gripper: &'a Gripper,
    from_zero: bool,
    now: Instant,
}

impl Registers<'_> {
    /// Which file a read means, and where in it: true for inputs.
    fn place(&self, at: u16, count: u16, function: u8) -> Result<(bool, usize), u8> {
        if count == 0 || count > 125 {
            return Err(ILLEGAL_VALUE);
        }
        let within = |first: u16| {
            let end = u32::from(at) + u32::from(count);
            (at >= first && end <= u32::from(first) + u32::from(COUNT)).then(|| usize::from(at - first) * 2)
        };
        let zero = self.from_zero.then(|| within(0)).flatten();
        let found = within(INPUTS).map(|at| (true, at)).or_else(|| within(OUTPUTS).map(|at| (false, at)));
        // Holding registers from zero are what was written; input registers the status.
        found.or(zero.map(|at| (function != 3, at))).ok_or(ILLEGAL_ADDRESS)
    }

    fn read(&self, at: u16, count: u16, function: u8) -> Result<Vec<u8>, u8> {
        let (inputs, at) = self.place(at, count, function)?;
        let mut machine = self.gripper.lock();
        let bytes = if inputs { machine.inputs(self.now) } else { machine.outputs() };
        let data = &bytes[at..at + 2 * usize::from(count)];
        let mut answer = vec![u8::try_from(data.len()).unwrap_or(u8::MAX)];
        answer.extend_from_slice(data);
        Ok(answer)
    }

    fn write(&self, at: u16, data: &[u8]) -> Result<(), u8> {
        let offset = |first: u16| {
            let at = usize::from(at.checked_sub(first)?) * 2;
            (at + data.len() <= 2 * usize::from(COUNT)).then_some(at)
        };
        let zero = if self.from_zero { offset(0) } else { None };
        let at = offset(OUTPUTS).or(zero).ok_or(ILLEGAL_ADDRESS)?;
        self.gripper.lock().write(at, data, self.now);
        Ok(())
    }
}
