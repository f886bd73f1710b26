//! Tests of the planning pool: order, refusal, death in the queue, panics, the end.

// Under `shuttle` the pool's threads are not the system's.
#![cfg(not(feature = "shuttle"))]

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
    Pool::start(PoolConfig {
        threads: 1,
        slots,
        servo_slots: 0,
        queue,
        scene_room: 2,
        nice: 0,
        plain_fifo: false,
    })
    .unwrap()
}

/// A scene of that size, not shared with anybody.
struct Scene(usize);

impl Gate for Scene {
    fn look(&self) -> Look {
        Look::Needs(self.0)
    }
}

fn order() -> Order {
    Order::brief(Flow(1))
}

/// Short forms for jobs of one caller.
trait Submit {
    fn plain<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        job: impl FnOnce(Turn) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError>;
    fn scene<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        room: usize,
        job: impl FnOnce(SceneRoom) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError>;
    fn continuation<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        job: impl FnOnce(Turn) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError>;
}

impl Submit for Pool {
    fn plain<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        job: impl FnOnce(Turn) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError> {
        self.submit(budget, &order(), None, job)
    }

    fn scene<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        room: usize,
        job: impl FnOnce(SceneRoom) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError> {
        self.submit(budget, &order(), Some(Arc::new(Scene(room))), |mut turn| job(turn.take_room()))
    }

    fn continuation<T: Send + 'static>(
        &self,
        budget: &CallBudget,
        job: impl FnOnce(Turn) -> T + Send + 'static,
    ) -> Result<Ticket<T>, PoolError> {
        self.submit_continuation(budget, &order(), job)
    }
}

/// Keeps one of the pool's slots busy until it is dropped.
struct Occupied {
    _release: mpsc::Sender<()>,
    _ticket: Ticket<()>,
}

fn occupy(pool: &Pool) -> Occupied {
    let (release, wait) = mpsc::channel::<()>();
    let (begun, began) = mpsc::channel();
    let ticket = pool.plain(&endless(), move |_| {
        begun.send(()).unwrap();
        wait.recv().ok();
    });
    let ticket = ticket.unwrap();
    assert_eq!(ticket.position, 0);
    began.recv().unwrap();
    Occupied { _release: release, _ticket: ticket }
}

#[tokio::test]
async fn a_full_queue_refuses_at_once_and_says_when_to_come_back() {
    let pool = pool(1, 2);
    let release = occupy(&pool);
    let kept: Vec<_> = (0..2).map(|i| pool.plain(&endless(), move |_| i).unwrap()).collect();
    assert_eq!(kept.iter().map(|t| t.position).collect::<Vec<_>>(), [0, 1]);
    let error = pool.plain(&endless(), |_| 9).unwrap_err();
    assert!(
        matches!(error, PoolError::Full { waiting: 2, limit: 2, retry_after } if retry_after > Duration::ZERO)
    );
    // What continues an admitted job is never refused.
    let mut continued = pool.continuation(&endless(), |_| 7).unwrap();
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
    let mut cancelled = pool.plain(&gone, |_| panic!("must not run")).unwrap();
    gone.cancel();
    let mut expired = pool.plain(&budget_ms(0), |_| panic!("must not run")).unwrap();
    let mut late = pool.plain(&budget_ms(30), |_| panic!("must not run")).unwrap();
    std::thread::sleep(Duration::from_millis(40));
    let mut alive = pool.plain(&endless(), |_| "alive").unwrap();
    drop(release);
    assert_eq!(late.wait().await.unwrap_err(), PoolError::Expired);
    assert_eq!(cancelled.wait().await.unwrap_err(), PoolError::Cancelled);
    assert_eq!(expired.wait().await.unwrap_err(), PoolError::Expired);
    assert_eq!(alive.wait().await.unwrap(), "alive");
}

#[tokio::test]
async fn the_most_urgent_job_goes_first() {
    let pool = pool(1, 8);
    let release = occupy(&pool);
    let (said, seen) = mpsc::channel();
    let mut tickets = Vec::new();
    for (ms, name) in [(60_000, "late"), (20_000, "soon"), (40_000, "middle")] {
        let said = said.clone();
        tickets.push(pool.plain(&budget_ms(ms), move |_| said.send(name).unwrap()).unwrap());
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
    let mut bad = pool.plain(&endless(), |_| -> () { panic!("on purpose") }).unwrap();
    assert_eq!(bad.wait().await, Err(PoolError::Panicked));
    let inside = pool.plain(&endless(), |_| rayon::join(|| 1, || -> i32 { panic!("on purpose") }));
    assert_eq!(inside.unwrap().wait().await, Err(PoolError::Panicked));
    let mut good = pool.plain(&endless(), |_| 3).unwrap();
    assert_eq!(good.wait().await.unwrap(), 3);
    assert_eq!(pool.waiting(), 0);
}

#[tokio::test]
async fn a_closed_pool_refuses_what_waits_and_what_comes() {
    let pool = pool(1, 4);
    let release = occupy(&pool);
    let mut waiting = pool.plain(&endless(), |_| 1).unwrap();
    pool.close();
    assert_eq!(waiting.wait().await, Err(PoolError::Closed));
    assert_eq!(pool.plain(&endless(), |_| 1).map(|_| ()), Err(PoolError::Closed));
    drop(release);
}

#[tokio::test]
async fn without_a_queue_only_free_slots_take_jobs() {
    let pool = pool(2, 0);
    let first = occupy(&pool);
    let second = occupy(&pool);
    assert!(matches!(pool.plain(&endless(), |_| ()), Err(PoolError::Full { limit: 0, .. })));
    drop((first, second));
}

#[tokio::test]
async fn what_continues_a_call_keeps_the_calls_place() {
    let pool = pool(1, 8);
    let release = occupy(&pool);
    let early = endless();
    let (said, seen) = mpsc::channel();
    let mut tickets = Vec::new();
    for name in ["new", "newer"] {
        let said = said.clone();
        let later = CallBudget::new(early.start() + Duration::from_millis(5), None);
        tickets.push(pool.scene(&later, 1, move |_| said.send(name).unwrap()).unwrap());
    }
    for name in ["first hand", "second hand"] {
        let said = said.clone();
        tickets.push(pool.continuation(&early, move |_| said.send(name).unwrap()).unwrap());
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
    let mut small = pool.scene(&endless(), 1, |room| room).unwrap();
    let small = small.wait().await.unwrap();
    assert_eq!(pool.scene_room_taken(), 1);
    // Asks for more than there is and so waits for all of it; the next scene may not overtake it.
    let mut large = pool.scene(&endless(), 5, |room| room).unwrap();
    let mut next = pool.scene(&endless(), 1, |room| room).unwrap();
    let mut other = pool.plain(&endless(), |_| "no scene").unwrap();
    let mut hand = pool.continuation(&endless(), |_| "has a scene").unwrap();
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
    let mut bad = pool.scene(&endless(), 2, |_| -> () { panic!("on purpose") }).unwrap();
    assert_eq!(bad.wait().await, Err(PoolError::Panicked));
    assert_eq!(pool.scene_room_taken(), 0);
    let held = pool.scene(&endless(), 1, |room| room).unwrap().wait().await.unwrap();
    let gone = endless();
    let mut dead = pool.scene(&gone, 2, |_| panic!("must not run")).unwrap();
    let mut next = pool.scene(&endless(), 1, |_| "runs").unwrap();
    gone.cancel();
    pool.drop_dead();
    assert_eq!(dead.wait().await, Err::<(), _>(PoolError::Cancelled));
    assert_eq!(next.wait().await.unwrap(), "runs");
    drop(held);
}

#[tokio::test]
async fn a_dropped_ticket_leaves_the_queue_at_once() {
    let pool = pool(1, 1);
    let release = occupy(&pool);
    let waiting = pool.plain(&endless(), |_| panic!("must not run")).unwrap();
    assert_eq!(pool.waiting(), 1);
    drop(waiting);
    assert_eq!(pool.waiting(), 0);
    let mut next = pool.plain(&endless(), |_| "runs").unwrap();
    drop(release);
    assert_eq!(next.wait().await.unwrap(), "runs");
}

#[tokio::test]
async fn what_cannot_finish_is_refused_without_waiting() {
    let pool = pool(1, 8);
    let long = Order { estimate: Estimate { least: SECOND, expected: SECOND }, ..order() };
    let (release, wait) = mpsc::channel::<()>();
    let _runs = pool.submit(&endless(), &long, None, move |_| wait.recv().ok()).unwrap();
    while pool.running() == 0 {
        std::thread::yield_now();
    }
    let began = Instant::now();
    let error = pool.submit(&budget_ms(1500), &long, None, |_| ()).unwrap_err();
    assert!(began.elapsed() < Duration::from_millis(500));
    let PoolError::CannotFinish { needs, left, retry_after } = error else { panic!("{error}") };
    assert!(needs > left && retry_after >= Duration::from_millis(300), "{needs:?} {left:?} {retry_after:?}");
    assert!(pool.submit(&budget_ms(2500), &long, None, |_| ()).is_ok());
    drop(release);
}

const SECOND: Duration = Duration::from_secs(1);

#[tokio::test]
async fn servo_jobs_begin_while_every_other_slot_is_busy() {
    let config = PoolConfig {
        threads: 1,
        slots: 1,
        servo_slots: 1,
        queue: 4,
        scene_room: 2,
        nice: 0,
        plain_fifo: false,
    };
    let pool = Pool::start(config).unwrap();
    let release = occupy(&pool);
    let mut waiting = pool.plain(&endless(), |_| "ordinary").unwrap();
    let servo = Order { priority: Priority::Servo, ..order() };
    let mut servo = pool.submit(&endless(), &servo, None, |_| "servo").unwrap();
    assert_eq!(servo.wait().await.unwrap(), "servo");
    assert_eq!(pool.waiting_by_priority(), [0, 1, 0, 0]);
    drop(release);
    assert_eq!(waiting.wait().await.unwrap(), "ordinary");
}

/// Many callers at once who change their minds: every ticket gets exactly one answer, and nothing is left.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn every_job_ends_once_under_a_storm_of_callers() {
    let pool = Arc::new(pool(3, 6));
    let ran = Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let mut callers = tokio::task::JoinSet::new();
    for i in 0..600u64 {
        let (pool, ran) = (Arc::clone(&pool), Arc::clone(&ran));
        callers.spawn(async move {
            tokio::time::sleep(Duration::from_micros(i * 97 % 30_000)).await;
            let budget = if i % 3 == 0 { budget_ms(i % 20) } else { endless() };
            let order = Order { priority: Priority::ALL[(i % 4) as usize], caller: Flow(i % 5), ..order() };
            let job_budget = budget.clone();
            let ticket = pool.submit(&budget, &order, None, move |_| {
                ran.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                std::thread::sleep(Duration::from_micros(200));
                job_budget.is_cancelled()
            });
            let Ok(mut ticket) = ticket else { return (0, 0, 1) };
            if i % 7 == 0 {
                let _cancel = budget.cancel_on_drop();
                return match tokio::time::timeout(Duration::from_micros(300), ticket.wait()).await {
                    Ok(Ok(_)) => (1, 0, 0),
                    Ok(Err(_)) | Err(_) => (0, 0, 1),
                };
            }
            match tokio::time::timeout(SECOND * 20, ticket.wait()).await {
                Ok(Ok(_)) => (1, 0, 0),
                Ok(Err(PoolError::Expired | PoolError::Shed { .. })) => (0, 1, 0),
                other => panic!("job {i}: {other:?}"),
            }
        });
    }
    let (mut done, mut dead, mut gone) = (0, 0, 0);
    let wake = Arc::clone(&pool);
    let timer = tokio::spawn(async move {
        loop {
            wake.drop_dead();
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    });
    while let Some(ended) = callers.join_next().await {
        let (a, b, c) = ended.unwrap();
        (done, dead, gone) = (done + a, dead + b, gone + c);
    }
    timer.abort();
    assert_eq!(done + dead + gone, 600);
    let ran = ran.load(std::sync::atomic::Ordering::Relaxed);
    assert!(
        done > 0 && ran >= done && ran <= done + gone,
        "{done} done, {dead} dead, {gone} gone, {ran} ran"
    );
    while pool.running() > 0 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!((pool.waiting(), pool.running()), (0, 0));
}

#[tokio::test]
async fn nobody_is_refused_for_the_rest_of_a_job_that_was_cancelled() {
    let pool = pool(1, 8);
    let minute = 60 * SECOND;
    let long = Order { estimate: Estimate { least: minute, expected: minute }, ..order() };
    let short = Order { estimate: Estimate { least: SECOND, expected: SECOND }, ..order() };
    let cancelled = endless();
    // A job that takes its time to notice.
    let (release, wait) = mpsc::channel::<()>();
    let _runs = pool.submit(&cancelled, &long, None, move |_| wait.recv().ok()).unwrap();
    while pool.running() == 0 {
        std::thread::yield_now();
    }
    let refused = pool.submit(&budget_ms(10_000), &short, None, |_| ()).unwrap_err();
    assert!(matches!(refused, PoolError::CannotFinish { .. }), "{refused}");
    cancelled.cancel();
    let mut admitted = pool.submit(&budget_ms(10_000), &short, None, |_| ()).unwrap();
    drop(release);
    admitted.wait().await.unwrap();
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn planning_threads_are_as_much_nicer_as_they_are_told() {
    let niceness = || rustix::process::getpriority_process(None).unwrap();
    for by in [0, 3, 19] {
        let config = PoolConfig { nice: by, slots: 1, servo_slots: 0, ..PoolConfig::for_cores(2) };
        let pool = Pool::start(config).unwrap();
        let mut ticket = pool.plain(&endless(), move |_| rayon::broadcast(|_| niceness())).unwrap();
        let found = ticket.wait().await.unwrap();
        let expected = (niceness() + i32::from(by)).min(19);
        assert!(
            found.len() == 2 && found.iter().all(|nice| *nice == expected),
            "{found:?}, expected {expected}"
        );
    }
    // Threads that answer are not.
    assert!(niceness() < 19);
}

#[cfg(target_os = "linux")]
#[tokio::test]
async fn servo_frames_get_the_cores_before_plans() {
    let niceness = || rustix::process::getpriority_process(None).unwrap();
    let servo = Order { priority: Priority::Servo, ..order() };
    let nicer = |by: i32| vec![(niceness() + by).min(19); 2];
    let config = PoolConfig { slots: 1, servo_slots: 1, ..PoolConfig::for_cores(2) };
    for (nice, expected) in [(5, [5, 0, 15]), (0, [0, 0, 0])] {
        let pool = Pool::start(PoolConfig { nice, ..config }).unwrap();
        let mut found = Vec::new();
        for order in [order(), servo, order()] {
            let mut ticket =
                pool.submit(&endless(), &order, None, move |_| rayon::broadcast(|_| niceness())).unwrap();
            found.push(ticket.wait().await.unwrap());
        }
        // A plan before any servo, a servo's frame, a plan beside it; the last may begin when that is over.
        assert_eq!(found[..2], expected.map(nicer)[..2], "of {nice}");
        assert!(found[2] == nicer(expected[2]) || found[2] == nicer(expected[0]), "{:?} of {nice}", found[2]);
    }
}
