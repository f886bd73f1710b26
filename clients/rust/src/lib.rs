//! A typed client of graspd with the documented retries.
//!
//! ```no_run
//! # async fn example() -> Result<(), graspd_client::ClientError> {
//! use graspd_client::{Client, ClientConfig, CameraIntrinsics, PlanGraspsRequest, depth_frame_u16};
//!
//! let client = Client::connect(ClientConfig::new("http://127.0.0.1:50051")).await?;
//! let lens = CameraIntrinsics { fx_px: 600.0, fy_px: 600.0, cx_px: 320.0, cy_px: 240.0, distortion: vec![] };
//! let pixels = vec![0u16; 640 * 480];
//! let frame = depth_frame_u16(640, 480, 0.001, &pixels, lens);
//! let request = PlanGraspsRequest { hand: "hands/leap".into(), frames: vec![frame], ..Default::default() };
//! let answer = client.plan_grasps(&request).await?;
//! println!("{} grasps", answer.grasps.len());
//! # Ok(())
//! # }
//! ```

mod client;
mod error;
mod frame;
mod hands;
mod retry;
mod servo;
mod stream;

pub use client::{Client, ClientConfig, ClientTls, Secret, Token};
pub use error::{CallError, ClientError, Violation};
pub use frame::{depth_frame_f32, depth_frame_u16};
/// Every message of the protocol, for what the names below leave out.
pub use graspd_proto::v1 as wire;
pub use graspd_proto::v1::{
    CameraIntrinsics, DepthFrame, Grasp, GraspOutcome, Hand, HandTask, PlanGraspsRequest, PlanGraspsResponse,
    PlanMultiHandRequest, PlanOptions, ReportOutcomeRequest, SceneOptions, ServoConfig, ServoFrame,
    ServoGraspResponse, ServoState,
};
pub use hands::CreatedHand;
pub use retry::RetryPolicy;
pub use servo::{ServoAnswers, ServoFrames, ServoStream};
pub use stream::{GraspEvent, GraspStream, MultiHandEvent, MultiHandStream};
pub use tonic::Code;
