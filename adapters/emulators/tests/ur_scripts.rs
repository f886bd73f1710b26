//! Scripts on the emulated controller, over its sockets: what runs, what is refused, and what that is called.

#![allow(clippy::unwrap_used, clippy::expect_used)] // Helpers of tests.

use std::time::{Duration, Instant};

use graspd_adapters_emulators::ur::{UrEmulator, UrPorts, UrSettings};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

async fn emulator() -> UrEmulator {
    UrEmulator::start(UrSettings { ports: UrPorts::FREE, ..UrSettings::default() }).await.unwrap()
}

async fn send(emulator: &UrEmulator, script: &str) -> TcpStream {
    let mut stream = TcpStream::connect(emulator.addresses().primary).await.unwrap();
    stream.write_all(script.as_bytes()).await.unwrap();
    stream
}

async fn register(emulator: &UrEmulator, register: usize, expected: i32) {
    let until = Instant::now() + Duration::from_secs(5);
    while emulator.snapshot().output_ints[register] != expected {
        assert!(Instant::now() < until, "{:?}", emulator.snapshot().output_ints);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Waits for words on the primary interface.
async fn hears(stream: &mut TcpStream, words: &str) {
    let mut heard = Vec::new();
    let listening = async {
        loop {
            stream.read_buf(&mut heard).await.unwrap();
            if heard.windows(words.len()).any(|w| w == words.as_bytes()) {
                return;
            }
        }
    };
    let heard = tokio::time::timeout(Duration::from_secs(5), listening).await;
    assert!(heard.is_ok(), "never: {words}");
}

#[tokio::test]
async fn functions_threads_and_lists_do_what_they_do_on_a_controller() {
    let emulator = emulator().await;
    let script = "def f():
  global total = 0
  global list = [1, 2, 3]
  def add(a, b=10):
    return a + b
  end
  thread count():
    while True:
      total = total + 1
      sync()
    end
  end
  copy = list
  copy[0] = 9
  write_output_integer_register(0, list[0])
  write_output_integer_register(1, add(b=1, a=2))
  write_output_integer_register(2, add(2))
  t = run count()
  sleep(0.1)
  kill t
  before = total
  sleep(0.05)
  if total == before and total > 20 and not total > 200:
    write_output_integer_register(3, 1)
  end
  write_output_integer_register(4, floor(norm([3, 4]) + 7 / 2))
end
";
    send(&emulator, script).await;
    register(&emulator, 4, 8).await;
    let ints = emulator.snapshot().output_ints;
    assert_eq!((ints[0], ints[1], ints[2], ints[3]), (1, 3, 12, 1));
}

#[tokio::test]
async fn mistakes_are_told_on_the_primary_interface() {
    let emulator = emulator().await;
    for (script, words) in [
        ("def f():\n  x = (1 + \nend\n", "expected a value"),
        ("def f():\n  x = y\nend\n", "y is not defined"),
        ("def f():\n  nonsense(1)\nend\n", "nonsense: not a function of this controller"),
        ("def f():\n  while True:\n    x = 1\n  end\nend\n", "infinite loop"),
        ("def f():\n  movej([0, 0, 0])\nend\n", "movej: found a list, expected six numbers"),
        ("def f():\n  x = [1][5]\nend\n", "no item 5"),
        ("def f():\n  def g():\n    g()\n  end\n  g()\nend\n", "calls nest too deep"),
        ("sec f():\n  movej([0, 0, 0, 0, 0, 0])\nend\n", "a secondary program may not move"),
        ("movel(p[9, 0, 0, 0, 0, 0], a=5, v=2)\n", "a joint faster than it may be"),
    ] {
        let mut stream = send(&emulator, script).await;
        hears(&mut stream, words).await;
    }
    emulator.set_remote_control(false);
    let mut stream = send(&emulator, "def f():\n  write_output_integer_register(7, 7)\nend\n").await;
    hears(&mut stream, "not in remote control").await;
    assert_eq!(emulator.snapshot().output_ints[7], 0);
}

#[tokio::test]
async fn a_new_program_replaces_the_one_that_runs_and_a_secondary_one_does_not() {
    let emulator = emulator().await;
    let endless = |n: i32| {
        format!(
            "def f():\n  while True:\n    write_output_integer_register(0, {n})\n    sync()\n  end\nend\n"
        )
    };
    send(&emulator, &endless(1)).await;
    register(&emulator, 0, 1).await;
    send(&emulator, "sec s():\n  write_output_integer_register(5, 5)\nend\n").await;
    register(&emulator, 5, 5).await;
    assert!(emulator.snapshot().program_running);
    send(&emulator, &endless(2)).await;
    register(&emulator, 0, 2).await;
    emulator.stop_program();
    let until = Instant::now() + Duration::from_secs(5);
    while emulator.snapshot().program_running {
        assert!(Instant::now() < until);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test]
async fn a_watchdog_that_nobody_feeds_stops_the_program() {
    let emulator = emulator().await;
    let script = "def f():\n  rtde_set_watchdog(\"input_int_register_0\", 10, \"stop\")\n  sleep(60)\nend\n";
    let mut stream = send(&emulator, script).await;
    hears(&mut stream, "watchdog: input_int_register_0 was not written in time").await;
    hears(&mut stream, "PROGRAM_XXX_STOPPED").await;
}

#[tokio::test]
async fn hostile_bytes_on_every_port_harm_nobody() {
    let emulator = emulator().await;
    let a = emulator.addresses();
    let mut junk: Vec<u8> = (0..60_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for port in [a.dashboard, a.primary, a.secondary, a.realtime, a.rtde] {
        let mut stream = TcpStream::connect(port).await.unwrap();
        // It may be cut in the middle.
        let _cut = tokio::time::timeout(Duration::from_secs(2), stream.write_all(&junk)).await;
        junk.rotate_left(7);
    }
    send(&emulator, "def f():\n  write_output_integer_register(6, 6)\nend\n").await;
    register(&emulator, 6, 6).await;
}
