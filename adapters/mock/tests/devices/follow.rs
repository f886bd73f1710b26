//! Arms that follow poses which change while they go.

use std::time::Duration;

use graspd_adapters_core::follow::lead;
use graspd_adapters_core::{Arm, ArmMode, DeviceError, FaultKind};
use graspd_adapters_mock::{After, Faults, MotionFault, StopKind};

use crate::fixtures::{LIMITS, SECOND, TEN, apart, arm, down, shared};

#[tokio::test]
async fn the_newest_pose_is_followed_while_others_let_time_go_by_and_the_end_is_told() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let (lead, goals) = lead();
    let start = arm.state(SECOND).await.unwrap().world_from_flange;
    let leading = async {
        assert!(lead.to(&down(0.10, 0.0, 0.25)));
        tokio::time::sleep(Duration::from_millis(60)).await;
        assert_eq!(shared.time_s(), 0.0, "thinking takes no time of this world");
        shared.wait(0.2).await.unwrap();
        let on_the_way = arm.state(SECOND).await.unwrap();
        assert_eq!(on_the_way.mode, ArmMode::Moving);
        let way = apart(&on_the_way.world_from_flange, &start);
        assert!(way > 0.01 && way < 0.06, "{way}");
        // There first, then elsewhere: it turns round on its way.
        let last = down(-0.03, 0.04, 0.22);
        lead.to(&down(0.0, 0.1, 0.25));
        lead.to(&last);
        tokio::task::yield_now().await;
        shared.wait(1.5).await.unwrap();
        let there = arm.state(SECOND).await.unwrap();
        assert!(apart(&there.world_from_flange, &last) < 1e-3);
        drop(lead);
    };
    // On a busy machine a pose may come later than a second after the last.
    let (followed, ()) = tokio::join!(arm.follow(goals, LIMITS, TEN, TEN), leading);
    followed.unwrap();
    assert_eq!(arm.state(SECOND).await.unwrap().mode, ArmMode::Ready);
}

#[tokio::test]
async fn who_falls_silent_or_goes_away_leaves_an_arm_that_stands() {
    let shared = shared(0.0);
    let arm = arm(&shared, Faults::default()).await;
    let far = down(0.3, 0.0, 0.25);
    let (lead_a, goals) = lead();
    lead_a.to(&far);
    let waiting = async {
        tokio::task::yield_now().await;
        shared.wait(2.0).await.unwrap();
    };
    let silence = Duration::from_millis(300);
    let (followed, ()) = tokio::join!(arm.follow(goals, LIMITS, silence, TEN), waiting);
    assert!(matches!(followed, Err(DeviceError::Timeout { .. })), "{followed:?}");
    let stands = arm.state(SECOND).await.unwrap();
    assert_eq!(stands.mode, ArmMode::Ready);
    assert!(apart(&stands.world_from_flange, &far) > 0.1, "it went on without anybody");
    drop(lead_a);
    // The call itself is given up.
    let (lead_b, goals) = lead();
    lead_b.to(&far);
    {
        let following = arm.follow(goals, LIMITS, TEN, TEN);
        let waiting = async {
            tokio::task::yield_now().await;
            shared.wait(0.3).await.unwrap();
        };
        tokio::select! {
            biased;
            done = following => panic!("{done:?}"),
            () = waiting => {}
        }
    }
    shared.wait(1.0).await.unwrap();
    let stands = arm.state(SECOND).await.unwrap();
    assert_eq!(stands.mode, ArmMode::Ready);
    assert!(apart(&stands.world_from_flange, &far) > 0.02);
}

#[tokio::test]
async fn poses_out_of_reach_and_stops_of_the_arm_end_it() {
    let shared = shared(0.0);
    let motion = Some(MotionFault { after: After::Metres(0.05), kind: StopKind::Protective });
    let arm = arm(&shared, Faults { motion, ..Faults::default() }).await;
    let (first, goals) = lead();
    first.to(&down(2.0, 0.0, 0.25));
    let refused = arm.follow(goals, LIMITS, SECOND, TEN).await.unwrap_err();
    assert!(matches!(refused, DeviceError::OutOfRange { .. }), "{refused}");
    let (second, goals) = lead();
    let leading = async {
        for k in 0..20 {
            // Each pose is less than the fault's way from the one before: what was gone counts on.
            second.to(&down(0.02 * f64::from(k), 0.0, 0.25));
            tokio::task::yield_now().await;
            if shared.wait(0.1).await.is_err() {
                return;
            }
        }
    };
    let stopped = tokio::select! {
        biased;
        done = arm.follow(goals, LIMITS, SECOND, TEN) => done.unwrap_err(),
        () = leading => panic!("it was never stopped"),
    };
    assert!(matches!(stopped, DeviceError::Fault { kind: FaultKind::ProtectiveStop, .. }), "{stopped}");
}
