//! Servers that vanish in the middle of a call: the call says so, and is repeated as the policy allows.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use graspd_client::{Client, ClientConfig, Code, PlanGraspsRequest, RetryPolicy};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

/// An empty SETTINGS frame of HTTP/2 (RFC 9113, 6.5), and the type of HEADERS frames.
const SETTINGS: [u8; 9] = [0, 0, 0, 4, 0, 0, 0, 0, 0];
const HEADERS: u8 = 1;
/// What a client says first.
const PREFACE: usize = 24;

/// How the server treats a call.
#[derive(Debug, Clone, Copy)]
enum End {
    /// Closes the connection.
    Closed,
    /// Closes it with a reset, as a killed process does whose socket still holds unread bytes.
    Reset,
    /// Resets the stream as cancelled and keeps the connection.
    StreamCancelled,
    /// Answers with bytes that are no HTTP/2.
    Garbage,
}

/// Reads until a call has begun, ends it as told; gives back if the socket failed before.
async fn serve(mut socket: TcpStream, end: End, calls: &AtomicUsize) -> std::io::Result<()> {
    socket.write_all(&SETTINGS).await?;
    let mut preface = [0; PREFACE];
    socket.read_exact(&mut preface).await?;
    loop {
        let mut head = [0; 9];
        socket.read_exact(&mut head).await?;
        let length = u32::from_be_bytes([0, head[0], head[1], head[2]]) as usize;
        if head[3] != HEADERS {
            let mut body = vec![0; length];
            socket.read_exact(&mut body).await?;
            continue;
        }
        calls.fetch_add(1, Ordering::SeqCst);
        match end {
            End::Closed => {
                let mut body = vec![0; length];
                socket.read_exact(&mut body).await?;
                return socket.shutdown().await;
            }
            End::Reset => return Ok(()),
            End::StreamCancelled => {
                let mut body = vec![0; length];
                socket.read_exact(&mut body).await?;
                let mut reset = vec![0, 0, 4, 3, 0];
                reset.extend_from_slice(&head[5..9]);
                reset.extend_from_slice(&8u32.to_be_bytes());
                socket.write_all(&reset).await?;
            }
            End::Garbage => return socket.write_all(&[0xff; 64]).await,
        }
    }
}

#[tokio::test]
async fn a_call_that_loses_its_connection_is_unavailable_and_repeated() {
    for end in [End::Closed, End::Reset, End::StreamCancelled] {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let calls = Arc::new(AtomicUsize::new(0));
        let seen = Arc::clone(&calls);
        let server = tokio::spawn(async move {
            while let Ok((socket, _)) = listener.accept().await {
                // What became of one connection does not matter to the next.
                serve(socket, end, &seen).await.ok();
            }
        });
        let retry = RetryPolicy { attempts: 3, ..RetryPolicy::default() };
        let client = Client::connect(ClientConfig::new(format!("http://{address}"))).await.unwrap();
        let client = client.with_retry(retry).with_timeout(Duration::from_secs(20));
        let error = client.plan_grasps(&PlanGraspsRequest::default()).await.unwrap_err();
        let call = error.call().unwrap();
        assert_eq!(
            (call.code, call.reason.as_str()),
            (Code::Unavailable, "CONNECTION_LOST"),
            "{end:?}: {error}"
        );
        assert_eq!(calls.load(Ordering::SeqCst), 3, "{end:?}");
        server.abort();
    }
}

/// Where the other side speaks no HTTP/2 there is nothing that could be repeated with success.
#[tokio::test]
async fn a_peer_that_is_no_grpc_server_is_not_asked_again_and_again() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let calls = Arc::new(AtomicUsize::new(0));
    let seen = Arc::clone(&calls);
    let server = tokio::spawn(async move {
        while let Ok((socket, _)) = listener.accept().await {
            serve(socket, End::Garbage, &seen).await.ok();
        }
    });
    let client = Client::connect(ClientConfig::new(format!("http://{address}"))).await.unwrap();
    let client = client.with_timeout(Duration::from_secs(20));
    let error = client.plan_grasps(&PlanGraspsRequest::default()).await.unwrap_err();
    assert_eq!(error.call().map(|call| call.code), Some(Code::Internal), "{error}");
    assert_eq!(calls.load(Ordering::SeqCst), 1);
    server.abort();
}
