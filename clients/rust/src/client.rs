//! The client: one connection, one deadline for each call.

use std::time::Duration;

use graspd_proto::v1::hand_service_client::HandServiceClient;
use graspd_proto::v1::planner_service_client::PlannerServiceClient;
use graspd_proto::v1::servo_service_client::ServoServiceClient;
use graspd_proto::v1::{PlanGraspsRequest, PlanGraspsResponse, PlanMultiHandRequest, StreamGraspsRequest};
use graspd_proto::v1::{ReportOutcomeRequest, ReportOutcomeResponse};
use tonic::Request;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};

use crate::error::ClientError;
use crate::retry::{RetryPolicy, retried};
use crate::stream::{GraspStream, MultiHandStream};

/// HTTP/2 window of a stream; the transport's default of 64 KiB would throttle answers with traces.
const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// HTTP/2 window of the connection.
const CONNECTION_WINDOW_BYTES: u32 = 32 << 20;

/// How a client connects and how long it waits.
#[derive(Debug, Clone, PartialEq)]
pub struct ClientConfig {
    /// Where the server is, for example `http://127.0.0.1:50051`.
    pub endpoint: String,
    /// How long to wait for the connection. Default 5 s.
    pub connect_timeout: Duration,
    /// Deadline of every call, all its attempts together. Default 10 s.
    pub call_timeout: Duration,
    /// Largest answer that is taken, bytes. Default 64 MiB.
    pub max_message_bytes: usize,
    /// What is repeated.
    pub retry: RetryPolicy,
    /// How an `https` endpoint is known and who this client is. Default none: `http`.
    pub tls: Option<ClientTls>,
    /// Sent with every call, where the server asks for one. Default none.
    pub token: Option<Token>,
}

/// What an encrypted connection needs, as PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClientTls {
    /// Roots that the server's certificate must come from.
    pub roots_pem: String,
    /// This client's certificate and its key, where the server asks for one.
    pub identity_pem: Option<(String, Secret)>,
    /// Name in the server's certificate, where it is not the endpoint's.
    pub server_name: Option<String>,
}

/// A bearer token.
pub type Token = Secret;

/// Text that does not appear in logs.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// Hides a text.
    pub fn new(text: impl Into<String>) -> Self {
        Self(text.into())
    }
}

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Secret(…)")
    }
}

impl ClientTls {
    fn config(&self) -> ClientTlsConfig {
        let mut config = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(&self.roots_pem));
        if let Some((certificate, key)) = &self.identity_pem {
            config = config.identity(Identity::from_pem(certificate, &key.0));
        }
        match &self.server_name {
            Some(name) => config.domain_name(name),
            None => config,
        }
    }
}

impl ClientConfig {
    /// The defaults for this server.
    pub fn new(endpoint: impl Into<String>) -> Self {
        Self {
            endpoint: endpoint.into(),
            connect_timeout: Duration::from_secs(5),
            call_timeout: Duration::from_secs(10),
            max_message_bytes: 64 << 20,
            retry: RetryPolicy::default(),
            tls: None,
            token: None,
        }
    }
}

/// A client. Cheap to clone; clones share the connection.
#[derive(Debug, Clone)]
pub struct Client {
    planner: PlannerServiceClient<Channel>,
    pub(crate) hands: HandServiceClient<Channel>,
    pub(crate) servo: ServoServiceClient<Channel>,
    pub(crate) call_timeout: Duration,
    pub(crate) retry: RetryPolicy,
    authorization: Option<MetadataValue<Ascii>>,
}

impl Client {
    /// Connects; repeats until the configured time is up, so that a server that is starting is waited for.
    ///
    /// # Errors
    /// [`ClientError::Connect`].
    pub async fn connect(config: ClientConfig) -> Result<Self, ClientError> {
        let fault = |problem: String| ClientError::Connect { endpoint: config.endpoint.clone(), problem };
        let endpoint = Endpoint::from_shared(config.endpoint.clone())
            .map_err(|e| fault(described(&e)))?
            .connect_timeout(config.connect_timeout)
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
            .tcp_nodelay(true);
        let endpoint = match &config.tls {
            Some(tls) => endpoint.tls_config(tls.config()).map_err(|e| fault(described(&e)))?,
            None => endpoint,
        };
        let authorization = match &config.token {
            None => None,
            Some(token) => {
                let value = MetadataValue::try_from(format!("Bearer {}", token.0));
                let mut value = value
                    .map_err(|_| fault("the token has characters that no header can have".to_owned()))?;
                value.set_sensitive(true);
                Some(value)
            }
        };
        let deadline = tokio::time::Instant::now() + config.connect_timeout;
        let channel = loop {
            match endpoint.connect().await {
                Ok(channel) => break channel,
                Err(error) if tokio::time::Instant::now() + config.retry.first_backoff >= deadline => {
                    return Err(fault(described(&error)));
                }
                Err(_) if config.retry.attempts > 1 => tokio::time::sleep(config.retry.first_backoff).await,
                Err(error) => return Err(fault(described(&error))),
            }
        };
        Ok(Self {
            planner: PlannerServiceClient::new(channel.clone())
                .max_decoding_message_size(config.max_message_bytes),
            servo: ServoServiceClient::new(channel.clone())
                .max_decoding_message_size(config.max_message_bytes),
            hands: HandServiceClient::new(channel).max_decoding_message_size(config.max_message_bytes),
            call_timeout: config.call_timeout,
            retry: config.retry,
            authorization,
        })
    }

    /// The same client with another deadline for its calls.
    #[must_use]
    pub fn with_timeout(&self, call_timeout: Duration) -> Self {
        Self { call_timeout, ..self.clone() }
    }

    /// The same client with another retry policy.
    #[must_use]
    pub fn with_retry(&self, retry: RetryPolicy) -> Self {
        Self { retry, ..self.clone() }
    }

    /// A request that tells the server how long its caller waits, and who it is.
    pub(crate) fn timed<T>(&self, message: T, left: Duration) -> Request<T> {
        let mut request = Request::new(message);
        request.set_timeout(left);
        self.authorized(request)
    }

    /// A request that tells the server who its caller is.
    pub(crate) fn authorized<T>(&self, mut request: Request<T>) -> Request<T> {
        if let Some(authorization) = &self.authorization {
            request.metadata_mut().insert("authorization", authorization.clone());
        }
        request
    }

    /// Plans grasps of one hand.
    ///
    /// # Errors
    /// [`ClientError`]. No grasp is not an error; then `no_grasp` of the answer says why.
    pub async fn plan_grasps(&self, request: &PlanGraspsRequest) -> Result<PlanGraspsResponse, ClientError> {
        retried(&self.retry, self.call_timeout, |left| {
            let (mut planner, request) = (self.planner.clone(), self.timed(request.clone(), left));
            async move { planner.plan_grasps(request).await.map(tonic::Response::into_inner) }
        })
        .await
    }

    /// Plans grasps of one hand and gives each better set as it is found. Dropping the stream cancels.
    ///
    /// # Errors
    /// [`ClientError`] when the stream does not begin; what happens later comes from the stream.
    pub async fn stream_grasps(&self, request: &PlanGraspsRequest) -> Result<GraspStream, ClientError> {
        let deadline = tokio::time::Instant::now() + self.call_timeout;
        let stream = retried(&self.retry, self.call_timeout, |left| {
            let request = StreamGraspsRequest { plan: Some(request.clone()) };
            let (mut planner, request) = (self.planner.clone(), self.timed(request, left));
            async move { planner.stream_grasps(request).await.map(tonic::Response::into_inner) }
        })
        .await?;
        Ok(GraspStream::new(stream, deadline))
    }

    /// Says what became of a grasp. Safe to repeat, and repeated as plans are.
    ///
    /// # Errors
    /// [`ClientError`]; `NO_RECORDING` where the server keeps none, `PLAN_NOT_FOUND` for a plan that it does not know.
    pub async fn report_outcome(
        &self,
        report: &ReportOutcomeRequest,
    ) -> Result<ReportOutcomeResponse, ClientError> {
        retried(&self.retry, self.call_timeout, |left| {
            let (mut planner, request) = (self.planner.clone(), self.timed(report.clone(), left));
            async move { planner.report_outcome(request).await.map(tonic::Response::into_inner) }
        })
        .await
    }

    /// Plans grasps of several hands in one scene. Dropping the stream cancels.
    ///
    /// # Errors
    /// As [`Client::stream_grasps`].
    pub async fn plan_multi_hand(
        &self,
        request: &PlanMultiHandRequest,
    ) -> Result<MultiHandStream, ClientError> {
        let deadline = tokio::time::Instant::now() + self.call_timeout;
        let stream = retried(&self.retry, self.call_timeout, |left| {
            let (mut planner, request) = (self.planner.clone(), self.timed(request.clone(), left));
            async move { planner.plan_multi_hand(request).await.map(tonic::Response::into_inner) }
        })
        .await?;
        Ok(MultiHandStream::new(stream, deadline))
    }
}

/// An error with its causes: the transport keeps the useful part for the last one.
fn described(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        // Layers that say the same as the one below are heard once.
        let said = inner.to_string();
        if !text.ends_with(&said) {
            text = format!("{text}: {said}");
        }
        cause = inner.source();
    }
    text
}
