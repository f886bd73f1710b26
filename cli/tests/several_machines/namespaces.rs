//! Hosts of their own: network namespaces with a switch between them. A cable is pulled at the switch, so that no host is
//! told: nothing passes any more, and that is all. Needs root and `ip`; without them it says that it is skipped, or fails
//! where `GRASPD_REQUIRE_NAMESPACES` is set.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use graspd_client::Code;

use crate::installation::{Front, Process, broker_program, eventually, without_settings};
use crate::{error, slow, small};

/// Set to 1 where the test must run.
const REQUIRED: &str = "GRASPD_REQUIRE_NAMESPACES";
/// Set for the half of the test that runs on a host of its own.
const INSIDE: &str = "GRASPD_TEST_NETWORK";
/// The switch, and the hosts behind its ports: the test's own with the front, the broker's, and a worker's.
const SWITCH: &str = "switch";
const HOSTS: [&str; 3] = ["front", "broker", "worker"];

fn ip(arguments: &[&str]) -> Result<(), String> {
    let done = Command::new("ip").args(arguments).stdin(Stdio::null()).output();
    let done = done.map_err(|e| format!("ip: {e}"))?;
    let said = || format!("ip {}: {}", arguments.join(" "), String::from_utf8_lossy(&done.stderr).trim());
    if done.status.success() { Ok(()) } else { Err(said()) }
}

/// A switch with hosts; all of it goes with this.
struct Network {
    /// Namespaces of several tests at the same time are told apart by this.
    tag: String,
}

impl Network {
    fn build() -> Result<Self, String> {
        let network = Self { tag: format!("gr{}", std::process::id() % 100_000) };
        let switch = network.name(SWITCH);
        ip(&["netns", "add", &switch])?;
        ip(&["-n", &switch, "link", "add", "br0", "type", "bridge"])?;
        ip(&["-n", &switch, "link", "set", "br0", "up"])?;
        for (i, host) in HOSTS.iter().enumerate() {
            let name = network.name(host);
            ip(&["netns", "add", &name])?;
            let port = Self::port(host);
            ip(&[
                "-n", &switch, "link", "add", &port, "type", "veth", "peer", "name", "eth0", "netns", &name,
            ])?;
            ip(&["-n", &switch, "link", "set", &port, "master", "br0", "up"])?;
            ip(&["-n", &name, "link", "set", "lo", "up"])?;
            ip(&["-n", &name, "addr", "add", &format!("{}/24", Self::address(i)), "dev", "eth0"])?;
            ip(&["-n", &name, "link", "set", "eth0", "up"])?;
        }
        Ok(network)
    }

    /// Where a host is; nobody outside of these namespaces can be there.
    fn address(host: usize) -> String {
        format!("10.213.7.{}", host + 1)
    }

    fn port(host: &str) -> String {
        format!("p-{host}")
    }

    fn name(&self, host: &str) -> String {
        format!("{}-{host}", self.tag)
    }

    /// Pulls a host's cable out of the switch, or puts it back: the host's own end stays up.
    fn plug(&self, host: &str, is_in: bool) {
        let (switch, port) = (self.name(SWITCH), Self::port(host));
        let mut arguments = vec!["-n", &switch, "link", "set", &port];
        arguments.extend(if is_in { vec!["master", "br0"] } else { vec!["nomaster"] });
        ip(&arguments).unwrap();
    }

    /// A command on a host.
    fn on(&self, host: &str, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.name(host), program]);
        without_settings(&mut command);
        command
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for host in HOSTS.iter().chain([&SWITCH]) {
            ip(&["netns", "del", &self.name(host)]).ok();
        }
    }
}

/// Builds the network and runs the test within it, on the front's host: whoever calls must be there too.
#[test]
fn a_cable_between_hosts_is_pulled_and_put_back() {
    if std::env::var_os(INSIDE).is_some() {
        return;
    }
    let network = match Network::build() {
        Ok(network) => network,
        Err(reason) => {
            let required = std::env::var(REQUIRED).is_ok_and(|value| !matches!(value.as_str(), "" | "0"));
            assert!(!required, "{REQUIRED} is set and there are no network namespaces: {reason}");
            eprintln!("skipped, there are no network namespaces: {reason}");
            return;
        }
    };
    let inside = std::env::current_exe().unwrap();
    let mut test = network.on(HOSTS[0], inside.to_str().unwrap());
    // What the broker's search is told counts there too.
    for name in ["GRASPD_REQUIRE_NATS", "GRASPD_NATS_SERVER"] {
        if let Some(value) = std::env::var_os(name) {
            test.env(name, value);
        }
    }
    if let Err(reason) = broker_program() {
        assert!(std::env::var_os("GRASPD_REQUIRE_NATS").is_none(), "there is no broker: {reason}");
        eprintln!("skipped, there is no broker: {reason}");
        return;
    }
    let ended = test
        .args(["--exact", "namespaces::on_hosts_of_their_own", "--ignored", "--nocapture"])
        .env(INSIDE, &network.tag)
        .status()
        .unwrap();
    assert!(ended.success(), "{ended}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "runs in the network that a_cable_between_hosts_is_pulled_and_put_back builds"]
async fn on_hosts_of_their_own() {
    // Run by itself, by somebody who asks for ignored tests: there is no network.
    let Ok(tag) = std::env::var(INSIDE) else { return };
    let network = std::mem::ManuallyDrop::new(Network { tag });
    let broker_at = format!("nats://{}:4222", Network::address(1));
    let folder: PathBuf = std::env::temp_dir().join(format!("graspd-{}-broker", network.tag));
    let mut command = network.on("broker", broker_program().unwrap().to_str().unwrap());
    let mut broker = Process::start(command.args(["-a", "0.0.0.0", "-p", "4222", "-js", "-sd"]).arg(&folder));
    broker.wait_for("Server is ready");
    let graspd = |host: &str, arguments: &[&str]| {
        let mut command = network.on(host, env!("CARGO_BIN_EXE_graspd"));
        command.args(arguments).args(["--threads", "1", "--slots", "1", "--insecure-engine", "--engine"]);
        Process::start(command.arg(&broker_at))
    };
    let mut far = graspd("worker", &["worker", "--drain-seconds", "1"]);
    far.wait_for("working");
    let mut front = Front::of(graspd("front", &["serve", "--listen", "127.0.0.1:0"]));
    let client = front.client().await;
    client.plan_grasps(&small()).await.unwrap();

    // The worker's cable is pulled while it plans: its job goes to another one.
    let calling = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&slow()).await })
    };
    eventually("the job runs", async || far.lines_with("waited_ms").len() == 2).await;
    network.plug("worker", false);
    let mut near = graspd("broker", &["worker", "--drain-seconds", "1"]);
    near.wait_for("attempt=2");
    calling.await.unwrap().unwrap();
    // Put back, the first one works again, alone.
    network.plug("worker", true);
    near.kill();
    eventually("the far worker plans", async || {
        client.plan_grasps(&small()).await.is_ok() && far.lines_with("waited_ms").len() >= 3
    })
    .await;

    // The front's cable is pulled: its callers hear of it long before their minute is over.
    let calling = {
        let client = client.clone();
        tokio::spawn(async move { client.plan_grasps(&slow()).await })
    };
    let before = far.lines_with("waited_ms").len();
    eventually("the job runs", async || far.lines_with("waited_ms").len() > before).await;
    let pulled = Instant::now();
    network.plug("front", false);
    let cut_off = error(calling.await.unwrap());
    assert_eq!((cut_off.code, cut_off.reason.as_str()), (Code::Unavailable, "ENGINE_AWAY"), "{cut_off}");
    assert!(pulled.elapsed() < Duration::from_secs(40), "{:?}", pulled.elapsed());
    let next = error(client.plan_grasps(&small()).await);
    assert_eq!((next.code, next.reason.as_str()), (Code::Unavailable, "ENGINE_AWAY"), "{next}");
    network.plug("front", true);
    front.wait_for("the broker is back");
    eventually("plans again", async || client.plan_grasps(&small()).await.is_ok()).await;
    drop((front, far));
    broker.kill();
    std::fs::remove_dir_all(folder).ok();
}
