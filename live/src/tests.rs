//! Tests of the live view over real sockets: what viewers get, and what becomes of strangers, slow ones and garbage.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::Mutex;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use graspd_proto::v1::PlanStats;
use graspd_recording::Schema;
use prost::Message as _;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::*;

/// Long enough for any machine.
const PATIENT: Duration = Duration::from_secs(30);

/// A picture of these topics that knows which of them were drawn.
#[derive(Debug, Default)]
struct Toy {
    time_ns: u64,
    topics: Vec<&'static str>,
    /// Bytes of padding in every message.
    weight: usize,
    drawn: Mutex<Vec<&'static str>>,
}

impl Toy {
    fn of(time_ns: u64, topics: &[&'static str]) -> Arc<Self> {
        Arc::new(Self { time_ns, topics: topics.to_vec(), ..Self::default() })
    }

    fn drawn(&self) -> Vec<&'static str> {
        self.drawn.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Picture for Toy {
    fn time_ns(&self) -> u64 {
        self.time_ns
    }

    fn draw(&self, bundle: &mut Bundle) {
        for topic in &self.topics {
            bundle.add(*topic, Schema::PlanStats, || {
                self.drawn.lock().unwrap_or_else(PoisonError::into_inner).push(topic);
                let hand = format!("{topic} {}{}", self.time_ns, "x".repeat(self.weight));
                PlanStats { hand, ..PlanStats::default() }
            });
        }
    }
}

async fn live(change: impl FnOnce(&mut LiveConfig)) -> Live {
    let mut config = LiveConfig::at(SocketAddr::from(([127, 0, 0, 1], 0)));
    change(&mut config);
    Live::start(config, "a server").await.unwrap()
}

/// A viewer, and what it knows.
struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    /// Numbers of channels by topic.
    channels: BTreeMap<String, u64>,
    faults: Vec<String>,
}

async fn knock(addr: SocketAddr, headers: &[(&'static str, &str)]) -> Result<Viewer, Error> {
    let mut request = format!("ws://{addr}/").into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", "foxglove.websocket.v1".parse().unwrap());
    for (name, value) in headers {
        request.headers_mut().insert(*name, value.parse().unwrap());
    }
    let (socket, _) = connect_async(request).await?;
    Ok(Viewer { socket, channels: BTreeMap::new(), faults: Vec::new() })
}

impl Viewer {
    async fn at(live: &Live) -> Self {
        let mut viewer = knock(live.local_addr(), &[]).await.unwrap();
        let info = viewer.words().await;
        assert_eq!((info["op"].as_str(), info["name"].as_str()), (Some("serverInfo"), Some("a server")));
        let channels = viewer.words().await;
        viewer.learn(&channels);
        viewer
    }

    async fn next(&mut self) -> Message {
        let next = async {
            loop {
                let next = self.socket.next().await.unwrap().unwrap();
                if !matches!(next, Message::Ping(_) | Message::Pong(_)) {
                    return next;
                }
            }
        };
        timeout(PATIENT, next).await.unwrap()
    }

    async fn words(&mut self) -> Value {
        match self.next().await {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            other => panic!("expected words, found {other:?}"),
        }
    }

    fn learn(&mut self, words: &Value) {
        match words["op"].as_str().unwrap() {
            "advertise" => {
                for channel in words["channels"].as_array().unwrap() {
                    assert_eq!(channel["encoding"], "protobuf");
                    assert_eq!(channel["schemaName"], "graspd.v1.PlanStats");
                    let topic = channel["topic"].as_str().unwrap().to_owned();
                    self.channels.insert(topic, channel["id"].as_u64().unwrap());
                }
            }
            "unadvertise" => {
                let gone = words["channelIds"].as_array().unwrap();
                self.channels.retain(|_, id| !gone.contains(&json!(*id)));
            }
            "status" => self.faults.push(words["message"].as_str().unwrap().to_owned()),
            other => panic!("{other}"),
        }
    }

    async fn say(&mut self, words: Value) {
        self.socket.send(Message::text(words.to_string())).await.unwrap();
    }

    /// Subscribes under the numbers 100 and up.
    async fn subscribe(&mut self, topics: &[&str]) {
        let numbered = topics.iter().zip(100..);
        let all: Vec<_> =
            numbered.map(|(topic, id)| json!({ "id": id, "channelId": self.channels[*topic] })).collect();
        self.say(json!({ "op": "subscribe", "subscriptions": all })).await;
    }

    /// The next data: the subscription, the time, the words in it.
    async fn data(&mut self) -> (u32, u64, String) {
        loop {
            match self.next().await {
                Message::Binary(data) => {
                    assert_eq!(data[0], 1);
                    let subscription = u32::from_le_bytes(data[1..5].try_into().unwrap());
                    let time_ns = u64::from_le_bytes(data[5..13].try_into().unwrap());
                    let hand = PlanStats::decode(&data[13..]).unwrap().hand;
                    return (subscription, time_ns, hand.trim_end_matches('x').to_owned());
                }
                Message::Text(text) => self.learn(&serde_json::from_str(&text).unwrap()),
                other => panic!("{other:?}"),
            }
        }
    }

    /// Until the server ends the connection; true if it said why.
    async fn end(mut self) -> bool {
        loop {
            match timeout(PATIENT, self.socket.next()).await.unwrap() {
                Some(Ok(Message::Close(frame))) => return frame.is_some(),
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return false,
            }
        }
    }
}

async fn until(mut done: impl FnMut() -> bool) {
    timeout(PATIENT, async {
        while !done() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await
    .unwrap();
}

#[tokio::test]
async fn who_comes_later_sees_what_was_shown_last_and_nothing_else_is_made() {
    let live = live(|_| {}).await;
    let (old, new) = (Toy::of(7, &["/a", "/old"]), Toy::of(8, &["/a", "/b"]));
    live.show(Layer::Plan, Arc::clone(&old) as _);
    live.show(Layer::Plan, Arc::clone(&new) as _);
    live.show(Layer::Servo, Toy::of(9, &["/a", "/c"]));
    let mut viewer = Viewer::at(&live).await;
    let topics: BTreeSet<&str> = viewer.channels.keys().map(String::as_str).collect();
    assert_eq!(topics, ["/a", "/b", "/c"].into());
    assert!(new.drawn().is_empty() && live.counts().drawn == 0, "nobody has subscribed");
    viewer.subscribe(&["/a"]).await;
    // One channel, two layers: both are shown.
    assert_eq!(viewer.data().await, (100, 8, "/a 8".to_owned()));
    assert_eq!(viewer.data().await, (100, 9, "/a 9".to_owned()));
    assert_eq!((new.drawn(), old.drawn()), (vec!["/a"], vec![]));
    // A second one gets the same bytes; they are not made again.
    let mut second = Viewer::at(&live).await;
    second.subscribe(&["/a", "/b"]).await;
    let mut got = [second.data().await, second.data().await, second.data().await];
    got.sort();
    assert_eq!(got.iter().map(|(_, _, text)| text.as_str()).collect::<Vec<_>>(), ["/a 8", "/a 9", "/b 8"]);
    assert_eq!(new.drawn(), ["/a", "/b"]);
    assert_eq!(live.counts().clients, 2);
}

#[tokio::test]
async fn channels_come_and_go_with_the_pictures() {
    let live = live(|_| {}).await;
    let mut viewer = Viewer::at(&live).await;
    assert!(viewer.channels.is_empty());
    live.show(Layer::Plan, Toy::of(1, &["/left", "/tf"]));
    let words = viewer.words().await;
    viewer.learn(&words);
    viewer.subscribe(&["/left", "/tf"]).await;
    let mut got = [viewer.data().await, viewer.data().await];
    got.sort();
    assert_eq!(got, [(100, 1, "/left 1".to_owned()), (101, 1, "/tf 1".to_owned())]);
    let before = viewer.channels.clone();
    live.show(Layer::Plan, Toy::of(2, &["/tf", "/right"]));
    assert_eq!(viewer.data().await, (101, 2, "/tf 2".to_owned()));
    assert_eq!(viewer.channels.keys().collect::<Vec<_>>(), ["/right", "/tf"]);
    assert_eq!(viewer.channels["/tf"], before["/tf"], "a channel that stays is the same");
    // The topic of a channel that is gone comes back under another number, and its subscription is gone.
    live.show(Layer::Plan, Toy::of(3, &["/left", "/tf"]));
    assert_eq!(viewer.data().await, (101, 3, "/tf 3".to_owned()));
    assert_ne!(viewer.channels["/left"], before["/left"]);
    viewer.say(json!({ "op": "unsubscribe", "subscriptionIds": [101, 7] })).await;
    // What is asked after that shows that it has been heard.
    viewer.say(json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": 9999 }] })).await;
    let words = viewer.words().await;
    viewer.learn(&words);
    live.show(Layer::Plan, Toy::of(4, &["/left", "/tf"]));
    viewer.subscribe(&["/left"]).await;
    let (_, _, text) = viewer.data().await;
    assert!(text.starts_with("/left"), "{text}: nothing of what was unsubscribed");
    assert!(viewer.faults[0].contains("there is no channel 9999"), "{:?}", viewer.faults);
}

#[tokio::test]
async fn a_number_is_one_subscription_and_a_channel_has_one() {
    let live = live(|_| {}).await;
    live.show(Layer::Plan, Toy::of(1, &["/a", "/b"]));
    let mut viewer = Viewer::at(&live).await;
    let (a, b) = (viewer.channels["/a"], viewer.channels["/b"]);
    let pairs = [(1, a), (1, b), (2, a)].map(|(id, channel)| json!({ "id": id, "channelId": channel }));
    viewer.say(json!({ "op": "subscribe", "subscriptions": pairs })).await;
    assert_eq!(viewer.data().await, (1, 1, "/a 1".to_owned()));
    assert_eq!(viewer.faults.len(), 2, "{:?}", viewer.faults);
    assert!(viewer.faults[0].contains("in use") && viewer.faults[1].contains("has one already"));
}

#[tokio::test]
async fn strangers_and_other_protocols_are_refused() {
    let live = live(|config| config.origins = vec!["https://viewer.example".to_owned()]).await;
    let addr = live.local_addr();
    let refused = async |headers: &[(&'static str, &str)]| match knock(addr, headers).await {
        Err(Error::Http(response)) => response.status().as_u16(),
        Err(other) => panic!("{other}"),
        Ok(_) => 101,
    };
    assert_eq!(refused(&[("origin", "https://evil.example")]).await, 403);
    assert_eq!(refused(&[("origin", "null")]).await, 403);
    assert_eq!(refused(&[("host", "evil.example:8765")]).await, 421);
    assert_eq!(refused(&[("sec-websocket-protocol", "mqtt")]).await, 400);
    assert_eq!(live.counts().refused, 4);
    assert_eq!(refused(&[("origin", "https://viewer.example")]).await, 101);
    assert_eq!(refused(&[("origin", "http://localhost:8080")]).await, 101);
}

#[tokio::test]
async fn there_are_only_so_many_places_and_they_come_back() {
    let live = live(|config| config.clients = 2).await;
    let first = Viewer::at(&live).await;
    let _second = Viewer::at(&live).await;
    match knock(live.local_addr(), &[]).await {
        Err(Error::Http(response)) => assert_eq!(response.status().as_u16(), 503),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("one too many"),
    }
    drop(first);
    timeout(PATIENT, async {
        while knock(live.local_addr(), &[]).await.is_err() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await
    .unwrap();
}

#[tokio::test]
async fn connections_that_say_nothing_keep_nobody_out() {
    let live = live(|_| {}).await;
    let mut silent = Vec::new();
    for _ in 0..30 {
        silent.push(TcpStream::connect(live.local_addr()).await.unwrap());
    }
    let mut viewer = Viewer::at(&live).await;
    live.show(Layer::Plan, Toy::of(1, &["/a"]));
    let words = viewer.words().await;
    viewer.learn(&words);
    // They are not kept for ever.
    let mut byte = [0];
    assert_eq!(timeout(PATIENT, silent[0].read(&mut byte)).await.unwrap().unwrap(), 0);
}

#[tokio::test]
async fn garbage_ends_its_own_connection_alone() {
    let live = live(|_| {}).await;
    live.show(Layer::Plan, Toy::of(1, &["/a"]));
    let mut good = Viewer::at(&live).await;
    // Before the handshake.
    for bytes in [&b"\x00\xff\x13\x37"[..], b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/9\r\nhost: x\r\n\r\n"] {
        let mut stream = TcpStream::connect(live.local_addr()).await.unwrap();
        stream.write_all(bytes).await.unwrap();
        let mut answer = Vec::new();
        // It ends; with an answer or without one.
        timeout(PATIENT, stream.read_to_end(&mut answer)).await.unwrap().ok();
        assert!(!answer.starts_with(b"HTTP/1.1 101"), "{answer:?}");
    }
    // After it: answered with words, and after too much of it the end.
    let mut wrong = Viewer::at(&live).await;
    for message in [
        Message::text("{"),
        Message::binary(vec![1, 2, 3]),
        Message::text(r#"{"op":"advertise","channels":[]}"#),
    ] {
        wrong.socket.send(message).await.unwrap();
        let words = wrong.words().await;
        assert_eq!((words["op"].as_str(), words["level"].as_u64()), (Some("status"), Some(2)));
    }
    for _ in 0..20 {
        // It may be gone already.
        wrong.socket.send(Message::text("nonsense")).await.ok();
    }
    wrong.end().await;
    until(|| live.counts().put_out == 1).await;
    // A message larger than any list of numbers.
    let mut large = Viewer::at(&live).await;
    large.socket.send(Message::text("x".repeat(1 << 20))).await.ok();
    large.end().await;
    good.subscribe(&["/a"]).await;
    assert_eq!(good.data().await, (100, 1, "/a 1".to_owned()));
}

#[tokio::test]
async fn who_reads_nothing_is_put_out_and_holds_up_nobody() {
    let live = live(|config| config.patience = Duration::from_millis(500)).await;
    let heavy = |time_ns| Arc::new(Toy { time_ns, topics: vec!["/a"], weight: 8 << 20, ..Toy::default() });
    live.show(Layer::Plan, heavy(0));
    let mut slow = Viewer::at(&live).await;
    slow.subscribe(&["/a"]).await;
    let mut quick = Viewer::at(&live).await;
    quick.subscribe(&["/a"]).await;
    let (mut newest, mut seen) = (0, 0);
    timeout(PATIENT, async {
        while live.counts().put_out == 0 {
            newest += 1;
            let before = std::time::Instant::now();
            live.show(Layer::Plan, heavy(newest));
            // Not a bound on speed: it does not wait for anybody, and the slow one would be waited for half a second.
            assert!(before.elapsed() < Duration::from_millis(400));
            seen = quick.data().await.1;
            assert!(seen <= newest);
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    })
    .await
    .unwrap();
    until(|| live.counts().clients == 1).await;
    // The quick one gets the newest in the end.
    while seen < newest {
        seen = quick.data().await.1;
    }
    assert!(newest > 1);
}

#[tokio::test]
async fn more_than_eyes_can_see_is_not_drawn() {
    let live = live(|_| {}).await;
    live.show(Layer::Plan, Toy::of(0, &["/a"]));
    let mut viewer = Viewer::at(&live).await;
    viewer.subscribe(&["/a"]).await;
    assert_eq!(viewer.data().await.1, 0);
    let began = std::time::Instant::now();
    const SHOWN: u64 = 200;
    for time_ns in 1..=SHOWN {
        live.show(Layer::Plan, Toy::of(time_ns, &["/a"]));
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let took = began.elapsed();
    // The last is not lost.
    while viewer.data().await.1 < SHOWN {}
    let counts = live.counts();
    // One at the beginning, one at the end, and the rate between.
    let most = took.as_secs_f64() * f64::from(PICTURES_PER_SECOND) + 3.0;
    assert!((counts.drawn as f64) <= most, "{counts:?} in {took:?}");
    assert!(counts.superseded > 0 && counts.superseded + counts.drawn >= SHOWN, "{counts:?}");
}

#[tokio::test]
async fn a_picture_that_cannot_be_drawn_is_left_out() {
    #[derive(Debug)]
    struct Broken;
    impl Picture for Broken {
        fn time_ns(&self) -> u64 {
            0
        }
        fn draw(&self, _: &mut Bundle) {
            panic!("cannot be drawn");
        }
    }
    let live = live(|_| {}).await;
    live.show(Layer::Plan, Arc::new(Broken));
    let mut viewer = Viewer::at(&live).await;
    assert!(viewer.channels.is_empty());
    live.show(Layer::Plan, Toy::of(1, &["/a"]));
    let words = viewer.words().await;
    viewer.learn(&words);
    viewer.subscribe(&["/a"]).await;
    assert_eq!(viewer.data().await, (100, 1, "/a 1".to_owned()));
}

#[tokio::test]
async fn it_ends_with_a_goodbye_and_gives_the_address_back() {
    let live = live(|_| {}).await;
    let viewer = Viewer::at(&live).await;
    let ending = tokio::spawn(viewer.end());
    timeout(PATIENT, live.close()).await.unwrap();
    assert!(timeout(PATIENT, ending).await.unwrap().unwrap(), "it said why");
    std::net::TcpListener::bind(live.local_addr()).unwrap();
    // What comes after the end is nobody's business.
    live.show(Layer::Plan, Toy::of(1, &["/a"]));
    live.close().await;
}

#[tokio::test]
async fn others_cannot_reach_it() {
    for addr in ["0.0.0.0:0", "192.0.2.1:8765", "[::]:0"] {
        let refused = Live::start(LiveConfig::at(addr.parse().unwrap()), "a server").await.unwrap_err();
        assert!(matches!(refused, LiveError::NotLoopback { .. }), "{refused}");
        assert!(refused.to_string().contains("expected a loopback address"), "{refused}");
    }
    let first = live(|_| {}).await;
    let taken = Live::start(LiveConfig::at(first.local_addr()), "a server").await.unwrap_err();
    assert!(matches!(taken, LiveError::Bind { .. }), "{taken}");
}
