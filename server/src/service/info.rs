//! `graspd.v1.InfoService`.

use std::sync::Arc;

use graspd_proto::v1;
use graspd_proto::v1::info_service_server::InfoService;
use tonic::{Request, Response, Status};

use crate::engine::Engine;

/// The service that says who answers.
#[derive(Debug, Clone)]
pub(crate) struct InfoApi {
    /// What every call shares.
    pub(crate) engine: Arc<Engine>,
    /// The server's limit.
    pub(crate) max_message_bytes: usize,
}

#[tonic::async_trait]
impl InfoService for InfoApi {
    async fn get_server_info(
        &self,
        _request: Request<v1::GetServerInfoRequest>,
    ) -> Result<Response<v1::GetServerInfoResponse>, Status> {
        Ok(Response::new(v1::GetServerInfoResponse {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            estimators: self.engine.estimators.names().map(str::to_owned).collect(),
            max_message_bytes: i64::try_from(self.max_message_bytes).unwrap_or(i64::MAX),
        }))
    }
}
