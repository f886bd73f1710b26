//! Tests of the planning pool: order, refusal, death in the queue, panics, the end.

use std::sync::mpsc;

use super::*;

fn budget_ms(ms: u64) -> CallBudget {
    let now = Instant::now();
    CallBudget::new(now, Some(now + Duration::from_millis(ms)))
}

fn endless() -> CallBudget {
    CallBudget::new(Instant::now(), None)
}

fn pool(slots: usize, queue: usize) -> Pool {
    Pool::start(PoolConfig { threads: 1, slots, queue, scene_room: 2 }).unwrap()
}

/// Keeps the pool's only slot busy until the returned sender is dropped.
fn occupy(pool: &Pool) -> mpsc::Sender<()> {
    let (release, wait) = mpsc::channel::<()>();
    let (begun, began) = mpsc::channel();
    let ticket = pool.submit(&endless(), move |_| {
        begun.send(()).unwrap();
        wait.recv().ok();
    });
    assert_eq!(ticket.unwrap().position, 0);
    began.recv().unwrap();
    release
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_says_when_to_come_back() {
    let pool = pool(1, 2);
    let release = occupy(&pool);
    let kept: Vec<_> = (0..2).map(|i| pool.submit(&endless(), move |_| i).unwrap()).collect();
    assert_eq!(kept.iter().map(|t| t.position).collect::<Vec<_>>(), [0, 1]);
    let error = pool.submit(&endless(), |_| 9).unwrap_err();
    assert!(
        matches!(error, PoolError::Full { waiting: 2, limit: 2, retry_after } if retry_after > Duration::ZERO)
    );
    // What continues an admitted job is never refused.
    let mut continued = pool.submit_continuation(&endless(), |_| 7).unwrap();
    drop(release);
    for (i, mut ticket) in kept.into_iter().enumerate() {
        assert_eq!(ticket.wait().await.unwrap(), i);
    }
    assert_eq!(continued.wait().await.unwrap(), 7);
}

#[tokio::test]
async fn dead_jobs_make_room_and_never_run() {
    let pool = pool(1, 1);
    let release = occupy(&pool);
    let gone = endless();
    let mut cancelled = pool.submit(&gone, |_| panic!("must not run")).unwrap();
    gone.cancel();
    let mut expired = pool.submit(&budget_ms(0), |_| panic!("must not run")).unwrap();
    let mut alive = pool.submit(&endless(), |_| "alive").unwrap();
    drop(release);
    assert_eq!(cancelled.wait().await.unwrap_err(), PoolError::Cancelled);
    assert_eq!(expired.wait().await.unwrap_err(), PoolError::Expired);
    assert_eq!(alive.wait().await.unwrap(), "alive");
}

#[tokio::test]
async fn the_most_urgent_job_goes_first() {
    let pool = pool(1, 8);
    let release = occupy(&pool);
    let (order, seen) = mpsc::channel();
    let mut tickets = Vec::new();
    for (ms, name) in [(60_000, "late"), (20_000, "soon"), (40_000, "middle")] {
        let order = order.clone();
        tickets.push(pool.submit(&budget_ms(ms), move |_| order.send(name).unwrap()).unwrap());
    }
    drop(release);
    for mut ticket in tickets {
        ticket.wait().await.unwrap();
    }
    assert_eq!(seen.try_iter().collect::<Vec<_>>(), ["soon", "middle", "late"]);
}

#[tokio::test]
async fn a_panic_is_one_jobs_own() {
    let pool = pool(1, 4);
    let mut bad = pool.submit(&endless(), |_| -> () { panic!("on purpose") }).unwrap();
    assert_eq!(bad.wait().await, Err(PoolError::Panicked));
    let inside = pool.submit(&endless(), |_| rayon::join(|| 1, || -> i32 { panic!("on purpose") }));
    assert_eq!(inside.unwrap().wait().await, Err(PoolError::Panicked));
    let mut good = pool.submit(&endless(), |_| 3).unwrap();
    assert_eq!(good.wait().await.unwrap(), 3);
    assert_eq!(pool.waiting(), 0);
}

#[tokio::test]
async fn a_closed_pool_refuses_what_waits_and_what_comes() {
    let pool = pool(1, 4);
    let release = occupy(&pool);
    let mut waiting = pool.submit(&endless(), |_| 1).unwrap();
    pool.close();
    assert_eq!(waiting.wait().await, Err(PoolError::Closed));
    assert_eq!(pool.submit(&endless(), |_| 1).map(|_| ()), Err(PoolError::Closed));
    drop(release);
}

#[tokio::test]
async fn without_a_queue_only_free_slots_take_jobs() {
    let pool = pool(2, 0);
    let first = occupy(&pool);
    let second = occupy(&pool);
    assert!(matches!(pool.submit(&endless(), |_| ()), Err(PoolError::Full { limit: 0, .. })));
    drop((first, second));
}

#[tokio::test]
async fn what_continues_a_call_keeps_the_calls_place() {
    let pool = pool(1, 8);
    let release = occupy(&pool);
    let early = endless();
    let (order, seen) = mpsc::channel();
    let mut tickets = Vec::new();
    for name in ["new", "newer"] {
        let order = order.clone();
        let later = CallBudget::new(early.start() + Duration::from_millis(5), None);
        tickets.push(pool.submit_scene(&later, 1, move |_, _| order.send(name).unwrap()).unwrap());
    }
    for name in ["first hand", "second hand"] {
        let order = order.clone();
        tickets.push(pool.submit_continuation(&early, move |_| order.send(name).unwrap()).unwrap());
    }
    drop(release);
    for mut ticket in tickets {
        ticket.wait().await.unwrap();
    }
    assert_eq!(seen.try_iter().collect::<Vec<_>>(), ["first hand", "second hand", "new", "newer"]);
}

#[tokio::test]
async fn scenes_begin_only_where_there_is_room_and_others_pass_them() {
    let pool = pool(3, 8);
    let mut small = pool.submit_scene(&endless(), 1, |_, room| room).unwrap();
    let small = small.wait().await.unwrap();
    assert_eq!(pool.scene_room_taken(), 1);
    // Asks for more than there is and so waits for all of it; the next scene may not overtake it.
    let mut large = pool.submit_scene(&endless(), 5, |_, room| room).unwrap();
    let mut next = pool.submit_scene(&endless(), 1, |_, room| room).unwrap();
    let mut other = pool.submit(&endless(), |_| "no scene").unwrap();
    let mut hand = pool.submit_continuation(&endless(), |_| "has a scene").unwrap();
    assert_eq!(other.wait().await.unwrap(), "no scene");
    assert_eq!(hand.wait().await.unwrap(), "has a scene");
    assert_eq!((pool.waiting(), pool.scene_room_taken()), (2, 1));
    drop(small);
    let large = large.wait().await.unwrap();
    assert_eq!((pool.waiting(), pool.scene_room_taken()), (1, 2));
    drop(large);
    drop(next.wait().await.unwrap());
    assert_eq!(pool.scene_room_taken(), 0);
}

#[tokio::test]
async fn room_comes_back_from_jobs_that_panic_and_dead_jobs_are_not_in_the_way() {
    let pool = pool(2, 8);
    let mut bad = pool.submit_scene(&endless(), 2, |_, _| -> () { panic!("on purpose") }).unwrap();
    assert_eq!(bad.wait().await, Err(PoolError::Panicked));
    assert_eq!(pool.scene_room_taken(), 0);
    let held = pool.submit_scene(&endless(), 1, |_, room| room).unwrap().wait().await.unwrap();
    let gone = endless();
    let mut dead = pool.submit_scene(&gone, 2, |_, _| panic!("must not run")).unwrap();
    let mut next = pool.submit_scene(&endless(), 1, |_, _| "runs").unwrap();
    gone.cancel();
    pool.drop_dead();
    assert_eq!(dead.wait().await, Err::<(), _>(PoolError::Cancelled));
    assert_eq!(next.wait().await.unwrap(), "runs");
    drop(held);
}
