//! RTDE, protocol version 2, as the controller serves it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;

use super::fields::{self, Input, Output};
use super::ports::Port;

/// A client that does not take what it is sent for so long is cut.
const SLOW_CLIENT: Duration = Duration::from_secs(1);

/// A package from a client: type and payload.
pub(crate) type Package = (u8, Vec<u8>);

/// Takes the first package from what came in. `Err` for a length that cannot be.
pub(crate) fn take_package(buffer: &mut Vec<u8>) -> Result<Option<Package>, String> {
    let [high, low, kind, ..] = buffer[..] else { return Ok(None) };
    let size = usize::from(u16::from_be_bytes([high, low]));
    if size < 3 {
        return Err(format!("a package of {size} bytes, expected at least 3"));
    }
    if buffer.len() < size {
        return Ok(None);
    }
    let payload = buffer[3..size].to_vec();
    buffer.drain(..size);
    Ok(Some((kind, payload)))
}

pub(crate) fn package(kind: u8, payload: &[u8]) -> Vec<u8> {
    let size = u16::try_from(payload.len() + 3).unwrap_or(u16::MAX);
    let mut out = size.to_be_bytes().to_vec();
    out.push(kind);
    out.extend(payload.iter().take(usize::from(u16::MAX) - 3));
    out
}

fn text_message(text: &str) -> Vec<u8> {
    let text = &text.as_bytes()[..text.len().min(255)];
    let mut payload = vec![text.len() as u8];
    payload.extend(text);
    payload.extend([4]);
    payload.extend(b"RTDE");
    payload.push(2);
    package(b'M', &payload)
}

fn names(payload: &[u8]) -> Vec<String> {
    // Clients write a comma after the last name, too.
    let text = String::from_utf8_lossy(payload);
    text.split(',').map(str::trim).filter(|n| !n.is_empty()).map(str::to_owned).collect()
}

/// Who owns which input field, over all connections.
pub(crate) type Owners = Arc<Mutex<HashMap<String, u64>>>;

/// One client.
struct Session {
    port: Port,
    owners: Owners,
    id: u64,
    outputs: Option<(u64, Vec<Output>)>,
    inputs: Vec<Vec<Input>>,
    running: bool,
}

impl Drop for Session {
    fn drop(&mut self) {
        let mut owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
        owners.retain(|_, owner| *owner != self.id);
    }
}

/// Serves a client until it goes.
pub(crate) async fn serve(port: Port, owners: Owners, id: u64, mut stream: TcpStream) -> std::io::Result<()> {
    let mut session = Session { port, owners, id, outputs: None, inputs: Vec::new(), running: false };
    let mut steps = session.port.steps.clone();
    let mut buffer = Vec::new();
    let mut sent_at = 0;
    let faults = session.port.faults.clone();
    loop {
        tokio::select! {
            read = stream.read_buf(&mut buffer) => {
                if read? == 0 {
                    return Ok(());
                }
                while let Some((kind, payload)) = take_package(&mut buffer).map_err(std::io::Error::other)? {
                    for reply in session.answer(kind, &payload) {
                        faults.send(&mut stream, &reply).await?;
                    }
                }
            }
            changed = steps.changed() => {
                if changed.is_err() {
                    return Ok(());
                }
                let step = *steps.borrow_and_update();
                if let Some(frame) = session.frame(step, &mut sent_at) {
                    tokio::time::timeout(SLOW_CLIENT, faults.send(&mut stream, &frame)).await??;
                }
            }
        }
    }
}

impl Session {
    /// The next package of values, if it is due.
    fn frame(&self, step: u64, sent_at: &mut u64) -> Option<Vec<u8>> {
        let (every, outputs) = self.outputs.as_ref()?;
        if !self.running || step < *sent_at + every {
            return None;
        }
        // Late: the controller leaves out what it cannot send.
        *sent_at = step - step % every;
        let robot = self.port.robot();
        let mut payload = vec![1];
        for output in outputs {
            output.write(&robot, &mut payload);
        }
        Some(package(b'U', &payload))
    }

    fn answer(&mut self, kind: u8, payload: &[u8]) -> Vec<Vec<u8>> {
        let replies = self.replies(kind, payload);
        if kind != b'U' || !replies.is_empty() {
            let shown = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
            let reply = replies.first().map(|r| shown(r));
            tracing::debug!(kind = %char::from(kind), asked = shown(payload), reply, "emulated RTDE");
        }
        replies
    }

    fn replies(&mut self, kind: u8, payload: &[u8]) -> Vec<Vec<u8>> {
        match kind {
            b'V' => {
                let accepted = payload == [0, 2];
                vec![package(b'V', &[u8::from(accepted)])]
            }
            b'v' => {
                let version = self.port.settings.version.iter().flat_map(|v| v.to_be_bytes());
                vec![package(b'v', &version.collect::<Vec<_>>())]
            }
            b'O' => vec![self.set_up_outputs(payload)],
            b'I' => vec![self.set_up_inputs(payload)],
            b'S' => {
                self.running = self.outputs.is_some();
                vec![package(b'S', &[u8::from(self.running)])]
            }
            b'P' => {
                self.running = false;
                vec![package(b'P', &[1])]
            }
            b'U' => self.take_inputs(payload).err().map(|why| text_message(&why)).into_iter().collect(),
            b'M' => Vec::new(),
            other => vec![text_message(&format!("unknown package type {other}"))],
        }
    }

    fn set_up_outputs(&mut self, payload: &[u8]) -> Vec<u8> {
        let refuse = |types: String| {
            let mut reply = vec![0];
            reply.extend(types.bytes());
            package(b'O', &reply)
        };
        let Some((hz, list)) = payload.split_first_chunk::<8>() else { return refuse(String::new()) };
        let hz = f64::from_be_bytes(*hz);
        let most = 1.0 / self.port.settings.model.step_s();
        let found: Vec<_> = names(list).iter().map(|n| fields::output(n)).collect();
        let words: Vec<_> = found.iter().map(|f| f.map_or("NOT_FOUND", |f| f.kind.word())).collect();
        let words = words.join(",");
        let all: Option<Vec<Output>> = found.into_iter().collect();
        let fits = hz.is_finite() && hz >= 1.0 && hz <= most + 1e-6;
        match all.filter(|all| fits && !all.is_empty() && !self.running) {
            None => refuse(words),
            Some(all) => {
                let every = ((most / hz).round() as u64).max(1);
                self.outputs = Some((every, all));
                let mut reply = vec![1];
                reply.extend(words.bytes());
                package(b'O', &reply)
            }
        }
    }

    fn set_up_inputs(&mut self, payload: &[u8]) -> Vec<u8> {
        let names = names(payload);
        let mut good = !names.is_empty() && self.inputs.len() < 254 && !self.running;
        let mut words = Vec::new();
        let mut recipe = Vec::new();
        {
            let robot = self.port.robot();
            let owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
            for name in &names {
                let Some(field) = fields::input(name) else {
                    words.push("NOT_FOUND");
                    good = false;
                    continue;
                };
                let taken = owners.get(name).is_some_and(|owner| *owner != self.id);
                if taken || robot.occupied.contains(name) {
                    words.push("IN_USE");
                    good = false;
                    continue;
                }
                words.push(field.kind.word());
                recipe.push(field);
            }
        }
        let mut reply = vec![0];
        if good {
            let mut owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
            owners.extend(names.into_iter().map(|name| (name, self.id)));
            self.inputs.push(recipe);
            reply[0] = self.inputs.len() as u8;
        }
        reply.extend(words.join(",").bytes());
        package(b'I', &reply)
    }

    fn take_inputs(&mut self, payload: &[u8]) -> Result<(), String> {
        let (id, values) = payload.split_first().ok_or("an empty data package")?;
        let recipe = usize::from(*id).checked_sub(1).and_then(|i| self.inputs.get(i));
        let recipe = recipe.ok_or_else(|| format!("input recipe {id} is not set up"))?;
        let expected: usize = recipe.iter().map(|f| f.kind.size()).sum();
        if values.len() != expected {
            return Err(format!("input recipe {id}: {} bytes, expected {expected}", values.len()));
        }
        let mut robot = self.port.robot();
        fields::apply(&mut robot, recipe, values);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn packages_are_taken_apart_as_published() {
        let mut buffer = vec![0x00, 0x05, 0x56, 0x00, 0x02, 0x00, 0x03];
        assert_eq!(take_package(&mut buffer).unwrap(), Some((b'V', vec![0, 2])));
        assert_eq!(take_package(&mut buffer).unwrap(), None);
        assert_eq!(package(b'v', &[]), [0x00, 0x03, 0x76]);
        assert_eq!(names(b"timestamp,actual_q,"), ["timestamp", "actual_q"]);
        assert!(take_package(&mut vec![0, 2, 0x56]).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut buffer = bytes.clone();
            while let Ok(Some((_, payload))) = take_package(&mut buffer) {
                prop_assert!(payload.len() <= bytes.len());
                names(&payload);
            }
        }
    }
}
