//! One viewer's connection, from its handshake to its end.

use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::http::header::{CONNECTION, CONTENT_LENGTH, SEC_WEBSOCKET_PROTOCOL};
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Bytes, Message, Utf8Bytes};

use crate::counts::{Counters, add};
use crate::door::{self, Refused};
use crate::hub::Event;
use crate::outbox::{Next, Outbox};
use crate::protocol::{self, Level};

/// Time for a handshake.
const HANDSHAKE: Duration = Duration::from_secs(5);
/// Viewers send lists of numbers.
const MOST_MESSAGE_BYTES: usize = 64 << 10;
/// What is no protocol may come so often; then the viewer is put out.
const MOST_FAULTS: u32 = 16;
/// A viewer that says nothing is asked this often whether anybody is there.
const PING: Duration = Duration::from_secs(15);

/// What all connections share.
#[derive(Debug)]
pub(crate) struct House {
    pub(crate) name: String,
    pub(crate) session: String,
    pub(crate) origins: Vec<String>,
    /// A viewer that takes nothing for so long is put out.
    pub(crate) patience: Duration,
    pub(crate) places: Arc<Semaphore>,
    pub(crate) counters: Arc<Counters>,
    pub(crate) events: mpsc::Sender<Event>,
}

/// How a connection ends from this side.
enum End {
    /// It is gone, or has said goodbye.
    Gone,
    /// The server ends.
    Closing,
    /// It is put out, for this reason.
    PutOut(CloseCode, &'static str),
}

/// Serves a connection until its end.
pub(crate) async fn serve(house: Arc<House>, id: u64, stream: TcpStream, mut stop: watch::Receiver<bool>) {
    // What is small is to be there at once.
    stream.set_nodelay(true).ok();
    let admitted = tokio::select! {
        admitted = timeout(HANDSHAKE, admit(&house, stream)) => admitted,
        () = ended(&mut stop) => return,
    };
    let Ok(Some((mut socket, _place))) = admitted else { return };
    let outbox = Arc::new(Outbox::new(Arc::clone(&house.counters)));
    outbox.say(protocol::server_info(&house.name, &house.session));
    if house.events.send(Event::Arrived(id, Arc::clone(&outbox))).await.is_err() {
        return;
    }
    let end = talk(&house, id, &mut socket, &outbox, &mut stop).await;
    house.events.send(Event::Left(id)).await.ok();
    let (code, reason) = match end {
        End::Gone => return,
        End::Closing => (CloseCode::Away, "the server ends"),
        End::PutOut(code, reason) => {
            add(&house.counters.put_out, 1);
            tracing::info!(id, reason, "a viewer of the live view is put out");
            (code, reason)
        }
    };
    let goodbye = CloseFrame { code, reason: Utf8Bytes::from_static(reason) };
    // Whoever does not read does not get to know.
    timeout(Duration::from_millis(200), socket.close(Some(goodbye))).await.ok();
}

/// Ready when the server ends.
pub(crate) async fn ended(stop: &mut watch::Receiver<bool>) {
    // The sender is gone when the server was dropped.
    stop.wait_for(|stopped| *stopped).await.ok();
}

/// The handshake.
async fn admit(
    house: &House,
    stream: TcpStream,
) -> Option<(WebSocketStream<TcpStream>, OwnedSemaphorePermit)> {
    let mut place = None;
    let config = WebSocketConfig::default()
        .read_buffer_size(4 << 10)
        .max_message_size(Some(MOST_MESSAGE_BYTES))
        .max_frame_size(Some(MOST_MESSAGE_BYTES));
    #[expect(clippy::result_large_err, reason = "the type that tungstenite wants")]
    let look = |request: &Request, mut response: Response| {
        let spoken = door::check(request.headers(), &house.origins).and_then(|spoken| {
            place = Some(Arc::clone(&house.places).try_acquire_owned().map_err(|_| Refused::Full)?);
            Ok(spoken)
        });
        match spoken {
            Ok(spoken) => {
                response.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(spoken));
                Ok(response)
            }
            Err(refused) => {
                add(&house.counters.refused, 1);
                tracing::warn!(%refused, "a viewer of the live view is refused");
                Err(refusal(&refused))
            }
        }
    };
    let socket = tokio_tungstenite::accept_hdr_async_with_config(stream, look, Some(config)).await.ok()?;
    Some((socket, place?))
}

fn refusal(refused: &Refused) -> ErrorResponse {
    let words = format!("{refused}\n");
    let length = words.len();
    let mut response = ErrorResponse::new(Some(words));
    *response.status_mut() = refused.status();
    response.headers_mut().insert(CONTENT_LENGTH, HeaderValue::from(length));
    response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    response
}

async fn talk(
    house: &House,
    id: u64,
    socket: &mut WebSocketStream<TcpStream>,
    outbox: &Outbox,
    stop: &mut watch::Receiver<bool>,
) -> End {
    let mut ping = tokio::time::interval(PING);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut heard = Instant::now();
    let mut faults = 0;
    loop {
        let (message, count) = tokio::select! {
            () = ended(stop) => return End::Closing,
            incoming = socket.next() => {
                heard = Instant::now();
                let fault = match incoming {
                    None | Some(Err(_)) | Some(Ok(Message::Close(_))) => return End::Gone,
                    Some(Ok(Message::Text(text))) => match protocol::request(&text) {
                        Ok(request) => {
                            if house.events.send(Event::Asked(id, request)).await.is_err() {
                                return End::Closing;
                            }
                            continue;
                        }
                        Err(fault) => fault.to_string(),
                    },
                    Some(Ok(Message::Binary(_))) => "found a binary message, expected none: nothing can be sent here".to_owned(),
                    Some(Ok(_)) => continue,
                };
                faults += 1;
                if faults > MOST_FAULTS {
                    return End::PutOut(CloseCode::Policy, "too much that is no message of the protocol");
                }
                outbox.say(protocol::status(Level::Error, &fault));
                continue;
            }
            next = outbox.take() => match next {
                Next::Overflow => return End::PutOut(CloseCode::Policy, "too slow"),
                Next::Words(words) => (Message::text(words), 0),
                Next::Data(subscription, time_ns, data) => {
                    let message = protocol::message_data(subscription, time_ns, &data);
                    (Message::binary(message), 1)
                }
            },
            _ = ping.tick() => {
                if heard.elapsed() > 3 * PING {
                    return End::PutOut(CloseCode::Policy, "nobody answers");
                }
                (Message::Ping(Bytes::new()), 0)
            }
        };
        match timeout(house.patience, socket.send(message)).await {
            Ok(Ok(())) => add(&house.counters.sent, count),
            Ok(Err(_)) => return End::Gone,
            Err(_) => return End::PutOut(CloseCode::Policy, "too slow"),
        }
    }
}
