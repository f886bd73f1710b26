//! Words of the Foxglove WebSocket protocol, version 1 (`foxglove.websocket.v1`, and `foxglove.sdk.v1`, which is the same
//! on the wire): <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>. Pure functions.
//!
//! The server offers no capability: viewers subscribe and look, and can send or set nothing.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use graspd_recording::Schema;
use serde::Deserialize;
use serde_json::json;

/// Subprotocols that are spoken, the newest first.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// The first byte of a message with data.
const MESSAGE_DATA: u8 = 1;
/// Subscriptions that one message may ask for.
const MOST_AT_ONCE: usize = 1024;

/// How grave a status is.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Level {
    Warning = 1,
    Error = 2,
}

/// A channel as it is told to viewers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Channel {
    pub(crate) id: u32,
    pub(crate) topic: String,
    pub(crate) schema: Schema,
}

/// What a viewer asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Request {
    /// Pairs of a number that the viewer chose and of a channel.
    Subscribe(Vec<(u32, u32)>),
    /// Numbers of subscriptions.
    Unsubscribe(Vec<u32>),
}

/// Why words were not understood.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Misunderstood {
    /// Not JSON of the protocol.
    #[error("found what is no message of the protocol: {0}")]
    Syntax(#[from] serde_json::Error),
    /// Something of the protocol that is not offered.
    #[error("found op {0:?}, expected subscribe or unsubscribe: this server offers nothing else")]
    NotOffered(String),
    /// Too much of it.
    #[error("found {0} subscriptions in one message, expected at most {MOST_AT_ONCE}")]
    TooMany(usize),
}

#[derive(Deserialize)]
struct Op {
    op: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u32,
}

#[derive(Deserialize)]
struct Subscribe {
    subscriptions: Vec<Subscription>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Unsubscribe {
    subscription_ids: Vec<u32>,
}

/// Reads a text message of a viewer.
pub(crate) fn request(text: &str) -> Result<Request, Misunderstood> {
    let Op { op } = serde_json::from_str(text)?;
    let (request, count) = match op.as_str() {
        "subscribe" => {
            let Subscribe { subscriptions } = serde_json::from_str(text)?;
            let pairs: Vec<_> = subscriptions.into_iter().map(|s| (s.id, s.channel_id)).collect();
            let count = pairs.len();
            (Request::Subscribe(pairs), count)
        }
        "unsubscribe" => {
            let Unsubscribe { subscription_ids } = serde_json::from_str(text)?;
            let count = subscription_ids.len();
            (Request::Unsubscribe(subscription_ids), count)
        }
        _ => return Err(Misunderstood::NotOffered(op.chars().take(40).collect())),
    };
    if count > MOST_AT_ONCE {
        return Err(Misunderstood::TooMany(count));
    }
    Ok(request)
}

/// The first words of a connection. `session` is another one after a restart, so that viewers begin anew.
pub(crate) fn server_info(name: &str, session: &str) -> String {
    json!({ "op": "serverInfo", "name": name, "capabilities": [], "supportedEncodings": [], "metadata": {}, "sessionId": session })
        .to_string()
}

/// Channels that there are from now on.
pub(crate) fn advertise<'a>(channels: impl IntoIterator<Item = &'a Channel>) -> String {
    let described = |channel: &Channel| {
        json!({
            "id": channel.id,
            "topic": channel.topic,
            "encoding": "protobuf",
            "schemaName": channel.schema.name(),
            "schema": STANDARD.encode(channel.schema.descriptors()),
            "schemaEncoding": "protobuf",
        })
    };
    let channels: Vec<_> = channels.into_iter().map(described).collect();
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// Channels that there are no longer.
pub(crate) fn unadvertise(ids: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": ids }).to_string()
}

/// Something that a person at the viewer should know.
pub(crate) fn status(level: Level, message: &str) -> String {
    json!({ "op": "status", "level": level as u8, "message": message }).to_string()
}

/// A message with data, as bytes.
pub(crate) fn message_data(subscription: u32, time_ns: u64, data: &[u8]) -> Vec<u8> {
    let mut message = Vec::with_capacity(13 + data.len());
    message.push(MESSAGE_DATA);
    message.extend(subscription.to_le_bytes());
    message.extend(time_ns.to_le_bytes());
    message.extend(data);
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn requests_are_read() {
        let read = |text: &str| request(text).map_err(|e| e.to_string());
        assert_eq!(
            read(r#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":3},{"id":7,"channelId":5}]}"#),
            Ok(Request::Subscribe(vec![(0, 3), (7, 5)]))
        );
        assert_eq!(
            read(r#"{"op":"unsubscribe","subscriptionIds":[0,1],"later":true}"#),
            Ok(Request::Unsubscribe(vec![0, 1]))
        );
        for wrong in [
            "",
            "[]",
            "{}",
            r#"{"op":5}"#,
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":3}]}"#,
            r#"{"op":"unsubscribe","subscriptionIds":[4294967296]}"#,
        ] {
            assert!(read(wrong).unwrap_err().starts_with("found what is no message"), "{wrong}");
        }
        assert!(
            read(r#"{"op":"setParameters","parameters":[]}"#).unwrap_err().contains("expected subscribe")
        );
        let many = format!(r#"{{"op":"unsubscribe","subscriptionIds":{:?}}}"#, vec![1; MOST_AT_ONCE + 1]);
        assert!(read(&many).unwrap_err().contains("expected at most"));
    }

    #[test]
    fn data_is_laid_out_as_the_specification_says() {
        let message = message_data(0x0403_0201, 0x0c0b_0a09_0807_0605, b"xyz");
        assert_eq!(message, [&[1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12][..], b"xyz"].concat());
    }

    proptest! {
        #[test]
        fn no_text_makes_it_fall_over(text in "\\PC{0,200}", op in "[a-z]{0,12}") {
            request(&text).ok();
            request(&format!(r#"{{"op":"{op}","subscriptions":[{text}]}}"#)).ok();
        }
    }
}
