//! Servo streams: frames in, refined grasps out.

use graspd_proto::v1::servo_grasp_request::Message;
use graspd_proto::v1::{ServoConfig, ServoFrame, ServoGraspRequest, ServoGraspResponse};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Streaming};

use crate::client::Client;
use crate::error::ClientError;

/// Frames that wait for the connection: one that is being sent, one behind it.
const WAITING: usize = 2;

/// A grasp that is carried on from frame to frame. Dropping it cancels the work.
///
/// Frames and answers go their own ways: the server answers the newest frame that it has, so there may be fewer answers
/// than frames. [`split`](Self::split) it where both are handled in different places.
#[derive(Debug)]
pub struct ServoStream {
    frames: ServoFrames,
    answers: ServoAnswers,
}

/// The side that sends.
#[derive(Debug, Clone)]
pub struct ServoFrames(mpsc::Sender<ServoGraspRequest>);

/// The side that receives.
#[derive(Debug)]
pub struct ServoAnswers(Streaming<ServoGraspResponse>);

impl Client {
    /// Begins to follow a grasp. The client's deadline is not that of the stream, which lasts as long as it is used; the
    /// server ends it when nothing is sent, or nothing is read, for some seconds.
    ///
    /// Never repeated: a stream that breaks off is another approach.
    ///
    /// # Errors
    /// [`ClientError`] when the server does not take the configuration.
    pub async fn servo_grasp(&self, config: ServoConfig) -> Result<ServoStream, ClientError> {
        let (sender, receiver) = mpsc::channel(WAITING);
        let first = ServoGraspRequest { message: Some(Message::Config(config)) };
        // The receiver is right here.
        sender.send(first).await.map_err(|_| ClientError::Protocol("a stream that ended at once"))?;
        let request = self.authorized(Request::new(ReceiverStream::new(receiver)));
        let mut servo = self.servo.clone();
        let begun = tokio::time::timeout(self.call_timeout, servo.servo_grasp(request)).await;
        let answers = match begun {
            Ok(answer) => answer?.into_inner(),
            Err(_) => return Err(crate::error::CallError::late().into()),
        };
        Ok(ServoStream { frames: ServoFrames(sender), answers: ServoAnswers(answers) })
    }
}

impl ServoStream {
    /// Sends a frame; see [`ServoFrames::send`].
    ///
    /// # Errors
    /// As [`ServoFrames::send`].
    pub async fn send(&self, frame: ServoFrame) -> Result<(), ClientError> {
        self.frames.send(frame).await
    }

    /// The next answer; see [`ServoAnswers::next`].
    ///
    /// # Errors
    /// As [`ServoAnswers::next`].
    pub async fn next(&mut self) -> Result<Option<ServoGraspResponse>, ClientError> {
        self.answers.next().await
    }

    /// Both sides apart.
    pub fn split(self) -> (ServoFrames, ServoAnswers) {
        (self.frames, self.answers)
    }
}

impl ServoFrames {
    /// Sends a frame; waits while the connection is slower than the camera. Drop all senders to end the stream.
    ///
    /// # Errors
    /// [`ClientError::Protocol`] when the stream has ended; the receiving side says why.
    pub async fn send(&self, frame: ServoFrame) -> Result<(), ClientError> {
        let message = ServoGraspRequest { message: Some(Message::Frame(frame)) };
        self.0.send(message).await.map_err(|_| ClientError::Protocol("a servo stream that has ended"))
    }

    /// Sends a frame if the connection has room for it now: a camera that must not wait leaves one out. False if it was
    /// left out.
    ///
    /// # Errors
    /// As [`ServoFrames::send`].
    pub fn try_send(&self, frame: ServoFrame) -> Result<bool, ClientError> {
        let message = ServoGraspRequest { message: Some(Message::Frame(frame)) };
        match self.0.try_send(message) {
            Ok(()) => Ok(true),
            Err(mpsc::error::TrySendError::Full(_)) => Ok(false),
            Err(mpsc::error::TrySendError::Closed(_)) => {
                Err(ClientError::Protocol("a servo stream that has ended"))
            }
        }
    }
}

impl ServoAnswers {
    /// The next answer; `None` after the last.
    ///
    /// # Errors
    /// [`ClientError`] when the stream ended with an error.
    pub async fn next(&mut self) -> Result<Option<ServoGraspResponse>, ClientError> {
        Ok(self.0.message().await?)
    }
}
