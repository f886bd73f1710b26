//! The connection to a rosbridge server, on a thread of its own: decoding takes time that others need.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use graspd_adapters_core::feed::Feed;
use graspd_adapters_core::stamps::{DeviceClock, ExposureCounter};
use graspd_adapters_core::streaming::{self, Done, Ended, Order, Orders};
use graspd_adapters_core::{DepthFrame, DeviceError, Lens};
use serde::de::DeserializeOwned;
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async_with_config};

use super::depth::{self, MessageError};
use super::messages::{CameraInfo, Envelope, Header, Image, PointCloud2, Published};
use crate::CameraState;
use crate::settings::{DepthTopic, FlexxSettings, RosbridgeSettings};

/// How long a message is waited for at a time: so soon an order is obeyed.
const POLL: Duration = Duration::from_millis(50);
/// Longest message that is taken: a cloud of the camera has about 1 MB.
const MOST_BYTES: usize = 32 << 20;
/// Longest text of another program that is passed on.
const MOST_TEXT: usize = 300;

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// The thread's own.
pub(crate) struct Bridge {
    settings: FlexxSettings,
    source: RosbridgeSettings,
    feed: Arc<Feed>,
    state: Arc<Mutex<CameraState>>,
    counter: ExposureCounter,
}

/// What one connection knows.
struct Link {
    clock: DeviceClock,
    lens: Option<Lens>,
    /// Last frame, or the beginning.
    last: Instant,
    frames: u64,
}

impl Bridge {
    pub(crate) fn new(
        settings: FlexxSettings,
        source: RosbridgeSettings,
        feed: Arc<Feed>,
        state: Arc<Mutex<CameraState>>,
    ) -> Self {
        let counter = ExposureCounter::new(settings.period());
        Self { settings, source, feed, state, counter }
    }

    /// Streams while somebody looks; connects again when the link was lost.
    pub(crate) fn run(mut self, orders: &Orders) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = match runtime {
            Ok(runtime) => runtime,
            Err(error) => {
                tracing::error!(device = self.settings.name, "no runtime for a camera: {error}");
                return;
            }
        };
        let feed = self.feed.clone();
        let retry = self.settings.retry();
        streaming::run(&feed, orders, retry, |orders| {
            let ended = runtime.block_on(self.session(orders));
            self.tell(|state| state.streaming = false);
            ended
        });
    }

    async fn session(&mut self, orders: &Orders) -> Ended {
        let socket = match self.connect(orders).await {
            Ok(socket) => socket,
            Err(ended) => return ended,
        };
        self.tell(|state| state.streaming = true);
        self.stream(socket, orders).await
    }

    async fn connect(&self, orders: &Orders) -> Result<Socket, Ended> {
        let url = &self.source.url;
        let until = Instant::now() + Duration::from_millis(self.source.connect_ms);
        let config =
            WebSocketConfig::default().max_message_size(Some(MOST_BYTES)).max_frame_size(Some(MOST_BYTES));
        let mut connecting = Box::pin(connect_async_with_config(url.as_str(), Some(config), true));
        let mut socket = loop {
            match timeout(POLL, &mut connecting).await {
                Ok(Ok((socket, _))) => break socket,
                Ok(Err(error)) => return Err(self.lost(format!("{url}: {error}"))),
                Err(_) => {}
            }
            match orders.look() {
                Some(Order::Stop(done)) => return Err(Ended::Stopped(done)),
                Some(Order::Quit) => return Err(Ended::Quit),
                _ => {}
            }
            if Instant::now() > until {
                return Err(self.lost(format!("{url}: no connection within {} ms", self.source.connect_ms)));
            }
        };
        drop(connecting);
        self.tell(|state| state.source = Some(url.clone()));
        for topic in [&self.source.camera_info, &self.source.topic] {
            // One message in the queue: the newest.
            let text = serde_json::json!({
                "op": "subscribe", "id": format!("graspd:{topic}"), "topic": topic,
                "compression": "none", "throttle_rate": 0, "queue_length": 1,
            });
            if let Err(error) = socket.send(Message::text(text.to_string())).await {
                return Err(self.lost(format!("{url}: {error}")));
            }
        }
        Ok(socket)
    }

    async fn stream(&mut self, mut socket: Socket, orders: &Orders) -> Ended {
        let mut link = Link {
            clock: DeviceClock::new(self.settings.latency()),
            lens: None,
            last: Instant::now(),
            frames: 0,
        };
        loop {
            match orders.look() {
                Some(Order::Stop(done)) => return Self::leave(socket, done).await,
                Some(Order::Quit) => return Ended::Quit,
                Some(Order::Wake) | None => {}
            }
            if link.last.elapsed() > self.settings.silence() {
                return self.lost(self.silence(&link));
            }
            let text = match timeout(POLL, socket.next()).await {
                Err(_) => continue,
                Ok(Some(Ok(Message::Text(text)))) => text,
                // Pings are answered by the library; other kinds were not asked for.
                Ok(Some(Ok(Message::Close(_))) | None) => {
                    return self.lost("the rosbridge server closed the connection".into());
                }
                Ok(Some(Ok(_))) => continue,
                Ok(Some(Err(error))) => return self.lost(error.to_string()),
            };
            if let Err(error) = self.heard(&text, &mut link) {
                return Ended::Lost(error);
            }
        }
    }

    /// Tells the server, and does not wait for its answer.
    async fn leave(mut socket: Socket, done: Done) -> Ended {
        let _closing = timeout(POLL, socket.close(None)).await;
        Ended::Stopped(done)
    }

    fn silence(&self, link: &Link) -> String {
        let silence = self.settings.silence();
        let (info, topic) = (&self.source.camera_info, &self.source.topic);
        if link.lens.is_none() {
            return format!("no message on {info} for {silence:?}: does the driver run, is that its topic?");
        }
        format!("no message on {topic} for {silence:?}, {} before: does the driver run?", link.frames)
    }

    /// One message of the protocol.
    fn heard(&mut self, text: &str, link: &mut Link) -> Result<(), DeviceError> {
        let arrived = Instant::now();
        let envelope: Envelope = self.read("message", text)?;
        if envelope.op == "status" && envelope.level == "error" {
            let told: Published<String> = self.read("status", text)?;
            let told: String = told.msg.chars().take(MOST_TEXT).collect();
            return Err(self.disconnected(format!("the rosbridge server says: {told}")));
        }
        if envelope.op != "publish" {
            return Ok(());
        }
        if envelope.topic == self.source.camera_info {
            let info: Published<CameraInfo> = self.read("camera info", text)?;
            let (width, height) = self.settings.size_px;
            if (info.msg.width as usize, info.msg.height as usize) != (width, height) {
                let found = format!("{} x {}", info.msg.width, info.msg.height);
                let expected = format!("{width} x {height} (`size_px`)");
                return Err(self.wrong(format!("camera info: found {found}, expected {expected}")));
            }
            link.lens =
                Some(depth::lens(&info.msg).map_err(|error| self.wrong(format!("camera info: {error}")))?);
            return Ok(());
        }
        if envelope.topic != self.source.topic {
            return Ok(());
        }
        // A frame without a lens is of no use; the lens comes with the next one.
        let Some(lens) = link.lens else { return Ok(()) };
        let (header, size, depth_m) = match self.source.depth {
            DepthTopic::Image => {
                let image: Image = self.read::<Published<_>>("image", text)?.msg;
                let depth_m = self.taken("image", depth::of_image(&image))?;
                (image.header, (image.width, image.height), depth_m)
            }
            DepthTopic::Points => {
                let cloud: PointCloud2 = self.read::<Published<_>>("points", text)?.msg;
                let depth_m = self.taken("points", depth::of_points(&cloud, self.settings.max_noise_m))?;
                (cloud.header, (cloud.width, cloud.height), depth_m)
            }
        };
        link.last = arrived;
        link.frames += 1;
        self.publish(&header, (size.0 as usize, size.1 as usize), depth_m, lens, arrived, &mut link.clock)
    }

    fn publish(
        &mut self,
        header: &Header,
        size: (usize, usize),
        depth_m: Vec<f32>,
        lens: Lens,
        arrived: Instant,
        clock: &mut DeviceClock,
    ) -> Result<(), DeviceError> {
        if size != self.settings.size_px {
            let expected = self.settings.size_px;
            return Err(self.wrong(format!("found {size:?} pixels, expected {expected:?} (`size_px`)")));
        }
        let stamp = header.stamp.since_1970();
        let frame = DepthFrame {
            width: size.0,
            height: size.1,
            depth_m: depth_m.into(),
            lens,
            world_from_camera: None,
            sequence: self.counter.count(stamp),
            stamp,
            age: Duration::ZERO,
        };
        self.feed.publish(frame, clock.exposed(stamp, arrived));
        Ok(())
    }

    fn read<T: DeserializeOwned>(&self, what: &str, text: &str) -> Result<T, DeviceError> {
        serde_json::from_str(text).map_err(|error| self.wrong(format!("{what}: {error}")))
    }

    fn taken<T>(&self, what: &str, outcome: Result<T, MessageError>) -> Result<T, DeviceError> {
        outcome.map_err(|error| self.wrong(format!("{what}: {error}")))
    }

    fn lost(&self, detail: String) -> Ended {
        Ended::Lost(self.disconnected(detail))
    }

    fn disconnected(&self, detail: String) -> DeviceError {
        DeviceError::Disconnected { device: self.settings.name.clone(), detail }
    }

    fn wrong(&self, detail: String) -> DeviceError {
        DeviceError::Protocol { device: self.settings.name.clone(), detail }
    }

    fn tell(&self, change: impl FnOnce(&mut CameraState)) {
        change(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
