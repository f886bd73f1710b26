//! The pseudo-terminal and its thread.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};

use super::LineDevice;
use crate::faults::LinkFaults;

/// Longest time without looking up, also the silence after which a frame that is not whole is forgotten.
const LOOK_UP: Duration = Duration::from_millis(20);

/// A serial line that clients open by its path. Ends, and takes the path away, when dropped.
///
/// A pseudo-terminal knows no baud rate: whatever a client sets is accepted. The device says when its bytes are on the
/// line.
#[derive(Debug)]
pub struct SerialLine {
    path: PathBuf,
    faults: LinkFaults,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SerialLine {
    /// Puts a device at the end of a new line. Clients open `path`, a symbolic link to the pseudo-terminal, which stays
    /// the same when the line hangs up and comes back; without one, a path in the folder for temporary files is taken.
    ///
    /// # Errors
    /// No pseudo-terminal can be had, or the link cannot be made: the path is taken by something that is no link.
    pub fn start(device: impl LineDevice, path: Option<PathBuf>) -> io::Result<Self> {
        let path = path.unwrap_or_else(free_path);
        let ends = Ends::open(&path)?;
        let (faults, stop) = (LinkFaults::default(), Arc::new(AtomicBool::new(false)));
        let server = Server {
            device,
            ends: Some(ends),
            path: path.clone(),
            faults: faults.clone(),
            stop: stop.clone(),
        };
        let thread = std::thread::Builder::new().name("serial line".into()).spawn(move || server.run())?;
        Ok(Self { path, faults, stop, thread: Some(thread) })
    }

    /// What clients open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Faults of this line.
    pub fn faults(&self) -> &LinkFaults {
        &self.faults
    }
}

impl Drop for SerialLine {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has said so already.
            let _ended = thread.join();
        }
    }
}

fn free_path() -> PathBuf {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let n = COUNT.fetch_add(1, Ordering::Relaxed);
    std::env::temp_dir().join(format!("graspd-line-{}-{n}", std::process::id()))
}

/// Both ends of a pseudo-terminal, and the link to the clients' end. The clients' end is kept open, else the device's
/// end reports an error whenever no client has it.
struct Ends {
    device: TTYPort,
    _clients: TTYPort,
    link: PathBuf,
}

impl Ends {
    fn open(link: &Path) -> io::Result<Self> {
        let (mut device, clients) = TTYPort::pair()?;
        device.set_timeout(LOOK_UP)?;
        let name = clients.name().ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
        if link.is_symlink() {
            std::fs::remove_file(link)?;
        }
        std::os::unix::fs::symlink(name, link)?;
        Ok(Self { device, _clients: clients, link: link.to_owned() })
    }
}

impl Drop for Ends {
    fn drop(&mut self) {
        // Somebody else may have taken it away.
        let _gone = std::fs::remove_file(&self.link);
    }
}

struct Server<D> {
    device: D,
    ends: Option<Ends>,
    path: PathBuf,
    faults: LinkFaults,
    stop: Arc<AtomicBool>,
}

impl<D: LineDevice> Server<D> {
    fn run(mut self) {
        let mut buffer = [0u8; 4096];
        while !self.stop.load(Ordering::Acquire) {
            if let Some(away) = self.faults.take_hang_up() {
                self.ends = None;
                self.wait(Instant::now() + away);
            }
            let Some(ends) = &mut self.ends else {
                match Ends::open(&self.path) {
                    Ok(ends) => self.ends = Some(ends),
                    Err(error) => {
                        tracing::warn!(path = %self.path.display(), %error, "the line cannot come back yet");
                        self.wait(Instant::now() + LOOK_UP);
                    }
                }
                continue;
            };
            match ends.device.read(&mut buffer) {
                Ok(0) => {
                    self.wait(Instant::now() + LOOK_UP);
                }
                Ok(n) => self.answer(&buffer[..n]),
                Err(error) if error.kind() == io::ErrorKind::TimedOut => self.device.silence(),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    tracing::warn!(%error, "the line broke; it is made anew");
                    self.ends = None;
                }
            }
        }
    }

    fn answer(&mut self, bytes: &[u8]) {
        let start = Instant::now();
        for reply in self.device.receive(bytes, start) {
            let late = self.faults.delay();
            let Some(bytes) = self.faults.befall(reply.bytes) else { continue };
            if !self.wait(start + reply.after + late) {
                return;
            }
            let Some(ends) = &mut self.ends else { return };
            if let Err(error) = ends.device.write_all(&bytes) {
                tracing::debug!(%error, "an answer could not be sent");
                return;
            }
        }
    }

    /// Waits, in short pieces; false when the line ends meanwhile.
    fn wait(&self, until: Instant) -> bool {
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if self.stop.load(Ordering::Acquire) {
                return false;
            }
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(LOOK_UP));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::line::Reply;

    struct Echo;

    impl LineDevice for Echo {
        fn receive(&mut self, bytes: &[u8], _: Instant) -> Vec<Reply> {
            vec![Reply { bytes: bytes.to_vec(), after: Duration::from_millis(1) }]
        }
    }

    fn ask(path: &Path, bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut port = TTYPort::open(
            &serialport::new(path.to_string_lossy(), 115_200).timeout(Duration::from_millis(500)),
        )?;
        port.write_all(bytes)?;
        let mut answer = vec![0; bytes.len()];
        port.read_exact(&mut answer)?;
        Ok(answer)
    }

    #[test]
    fn a_line_answers_hangs_up_comes_back_and_goes() {
        let line = SerialLine::start(Echo, None).unwrap();
        let path = line.path().to_owned();
        assert_eq!(ask(&path, b"\x03\x11abc").unwrap(), b"\x03\x11abc");
        line.faults().hang_up(Duration::from_millis(100));
        let until = Instant::now() + Duration::from_secs(5);
        while path.exists() {
            assert!(Instant::now() < until, "the line did not hang up");
            std::thread::sleep(Duration::from_millis(5));
        }
        while !path.exists() {
            assert!(Instant::now() < until, "the line did not come back");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(ask(&path, b"again").unwrap(), b"again");
        drop(line);
        assert!(!path.is_symlink());
    }

    #[test]
    fn a_path_that_is_a_file_is_left_alone() {
        let path = free_path();
        std::fs::write(&path, "mine").unwrap();
        assert!(SerialLine::start(Echo, Some(path.clone())).is_err());
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
        std::fs::remove_file(&path).unwrap();
    }
}
