//! Laws of the pool under random schedules: its own threads and locks, run by a scheduler that chooses at every
//! step who goes on. A thread that waits for ever is a deadlock there, and fails.
//!
//! `cargo test -p graspd-server --features shuttle --lib schedules`; a failure prints a schedule that repeats it.

#![cfg(feature = "shuttle")]

use std::sync::atomic::{AtomicUsize, Ordering};

use graspd_scheduler::Priority;
use shuttle::future::block_on;
use shuttle::rand::{Rng as _, thread_rng};

use super::*;

/// Schedules of each test.
const SCHEDULES: usize = 3_000;
/// Steps until a thread is preempted at most: depth of the probabilistic search for rare orders.
const DEPTH: usize = 3;

/// Runs a test under random schedules, then under those that change threads seldom and at the worst place.
fn schedules(test: impl Fn() + Send + Sync + Clone + 'static) {
    shuttle::check_random(test.clone(), SCHEDULES);
    shuttle::check_pct(test, SCHEDULES, DEPTH);
}

fn pool(slots: usize, servo_slots: usize, queue: usize, scene_room: usize) -> Arc<Pool> {
    let config = PoolConfig { threads: 1, slots, servo_slots, queue, scene_room, nice: 0, plain_fifo: false };
    match Pool::start(config) {
        Ok(pool) => Arc::new(pool),
        Err(error) => panic!("{error}"),
    }
}

fn endless() -> CallBudget {
    CallBudget::new(Instant::now(), None)
}

fn order(priority: Priority, flow: u64) -> Order {
    Order { priority, ..Order::brief(Flow(flow)) }
}

/// How many are at it at the same time, and how many were at most.
#[derive(Default)]
struct Gauge {
    now: AtomicUsize,
    most: AtomicUsize,
}

impl Gauge {
    fn during<R>(&self, amount: usize, work: impl FnOnce() -> R) -> R {
        let now = self.now.fetch_add(amount, Ordering::SeqCst) + amount;
        self.most.fetch_max(now, Ordering::SeqCst);
        let result = work();
        self.now.fetch_sub(amount, Ordering::SeqCst);
        result
    }
}

struct Scene(usize);

impl Gate for Scene {
    fn look(&self) -> Look {
        Look::Needs(self.0)
    }
}

/// Shut until somebody opens it.
#[derive(Default)]
struct Door(std::sync::atomic::AtomicBool);

impl Gate for Door {
    fn look(&self) -> Look {
        if self.0.load(Ordering::SeqCst) { Look::Open } else { Look::Shut }
    }
}

/// Every job ends exactly once, however callers leave, cancel, wait or find the queue full; no more run than there
/// are slots; afterwards nothing waits, runs or takes room.
#[test]
fn every_job_ends_once_and_nothing_is_left() {
    schedules(|| {
        let pool = pool(2, 0, 3, 2);
        let at_once = Arc::new(Gauge::default());
        let rooms = Arc::new(Gauge::default());
        let runs: Arc<Vec<AtomicUsize>> = Arc::new((0..6).map(|_| AtomicUsize::new(0)).collect());
        let callers: Vec<_> = (0..6)
            .map(|n| {
                let (pool, at_once) = (Arc::clone(&pool), Arc::clone(&at_once));
                let (rooms, runs) = (Arc::clone(&rooms), Arc::clone(&runs));
                shuttle::thread::spawn(move || {
                    let budget = endless();
                    let priority = [Priority::Low, Priority::Normal, Priority::High][n % 3];
                    let size = 1 + n % 2;
                    let job = {
                        let (at_once, runs) = (Arc::clone(&at_once), Arc::clone(&runs));
                        move |mut turn: Turn| {
                            let room = turn.take_room();
                            let work = || rooms.during(size, shuttle::thread::yield_now);
                            at_once.during(1, work);
                            runs[n].fetch_add(1, Ordering::SeqCst);
                            drop(room);
                            n
                        }
                    };
                    let gate = Arc::new(Scene(size));
                    let ticket = pool.submit(&budget, &order(priority, n as u64 % 2), Some(gate), job);
                    let mut ticket = match ticket {
                        Ok(ticket) => ticket,
                        Err(PoolError::Full { .. }) => return,
                        Err(error) => panic!("{error}"),
                    };
                    match thread_rng().gen_range(0..4) {
                        0 => drop(ticket),
                        1 => {
                            budget.cancel();
                            pool.drop_dead();
                            let end = block_on(ticket.wait());
                            assert!(matches!(
                                end,
                                Ok(_) | Err(PoolError::Cancelled | PoolError::Shed { .. })
                            ));
                        }
                        _ => match block_on(ticket.wait()) {
                            Ok(value) => {
                                assert_eq!(value, n);
                                assert_eq!(runs[n].load(Ordering::SeqCst), 1);
                            }
                            Err(PoolError::Shed { .. }) => assert_eq!(runs[n].load(Ordering::SeqCst), 0),
                            Err(error) => panic!("{error}"),
                        },
                    }
                })
            })
            .collect();
        callers.into_iter().for_each(|caller| caller.join().unwrap());
        while pool.running() > 0 {
            shuttle::thread::yield_now();
        }
        assert_eq!((pool.waiting(), pool.scene_room_taken()), (0, 0));
        assert!(at_once.most.load(Ordering::SeqCst) <= 2);
        assert!(rooms.most.load(Ordering::SeqCst) <= 2);
        assert!(runs.iter().all(|n| n.load(Ordering::SeqCst) <= 1));
    });
}

/// What waits behind a gate goes on when the job that opens it says so: no wake-up is lost, and a waiting job takes no
/// slot from the one that it waits for.
#[test]
fn jobs_behind_a_gate_are_woken() {
    schedules(|| {
        let pool = pool(1, 0, 4, 2);
        let door = Arc::new(Door::default());
        let mut behind: Vec<_> = (0..2)
            .map(|n| {
                let gate = Arc::clone(&door) as Arc<dyn Gate>;
                pool.submit(&endless(), &order(Priority::Normal, n), Some(gate), move |_| n).unwrap()
            })
            .collect();
        let opens = {
            let door = Arc::clone(&door);
            move |turn: Turn| {
                shuttle::thread::yield_now();
                door.0.store(true, Ordering::SeqCst);
                turn.wake_others();
            }
        };
        let mut opener = pool.submit(&endless(), &order(Priority::Low, 9), None, opens).unwrap();
        block_on(opener.wait()).unwrap();
        for (n, ticket) in behind.iter_mut().enumerate() {
            assert_eq!(block_on(ticket.wait()).unwrap(), n as u64);
        }
    });
}

/// Scenes outlive the jobs that read them: whoever waits for room goes on when the last one lets it go, and when the
/// large one that nobody may overtake gives up.
#[test]
fn room_that_is_given_back_is_noticed() {
    schedules(|| {
        let pool = pool(2, 0, 4, 2);
        let scene = |room| Some(Arc::new(Scene(room)) as Arc<dyn Gate>);
        let keep = |mut turn: Turn| turn.take_room();
        let normal = order(Priority::Normal, 1);
        let mut first = pool.submit(&endless(), &normal, scene(1), keep).unwrap();
        let kept = block_on(first.wait()).unwrap();
        let large = pool.submit(&endless(), &normal, scene(2), keep).unwrap();
        let mut small = pool.submit(&endless(), &normal, scene(1), keep).unwrap();
        if thread_rng().gen_bool(0.5) {
            let leaver = shuttle::thread::spawn(move || drop(large));
            block_on(small.wait()).unwrap();
            leaver.join().unwrap();
            drop(kept);
        } else {
            let mut large = large;
            let letter = shuttle::thread::spawn(move || drop(kept));
            drop(block_on(large.wait()).unwrap());
            block_on(small.wait()).unwrap();
            letter.join().unwrap();
        }
        assert_eq!(pool.waiting(), 0);
    });
}

/// While a slot is busy, what waits is ordered by priority whatever the order of arrival.
#[test]
fn the_more_urgent_begins_first() {
    schedules(|| {
        let pool = pool(1, 0, 8, 2);
        let door = Arc::new(Door::default());
        let begun = Arc::new(Mutex::new(Vec::new()));
        let hold = {
            let door = Arc::clone(&door);
            move |_: Turn| {
                while !door.0.load(Ordering::SeqCst) {
                    shuttle::thread::yield_now();
                }
            }
        };
        let mut held = pool.submit(&endless(), &order(Priority::High, 9), None, hold).unwrap();
        while pool.running() == 0 {
            shuttle::thread::yield_now();
        }
        let arrivals = [Priority::Low, Priority::High, Priority::Normal, Priority::Low, Priority::High];
        let callers: Vec<_> = arrivals
            .into_iter()
            .map(|priority| {
                let (pool, begun) = (Arc::clone(&pool), Arc::clone(&begun));
                shuttle::thread::spawn(move || {
                    let note = move |_: Turn| begun.lock().unwrap().push(priority);
                    pool.submit(&endless(), &order(priority, 1), None, note).unwrap()
                })
            })
            .collect();
        let mut tickets: Vec<_> = callers.into_iter().map(|caller| caller.join().unwrap()).collect();
        door.0.store(true, Ordering::SeqCst);
        block_on(held.wait()).unwrap();
        tickets.iter_mut().for_each(|ticket| block_on(ticket.wait()).unwrap());
        let rank = |p: &Priority| Priority::ALL.iter().position(|q| q == p);
        let ranks: Vec<_> = begun.lock().unwrap().iter().map(rank).collect();
        let mut sorted = ranks.clone();
        sorted.sort();
        let reversed: Vec<_> = sorted.iter().rev().copied().collect();
        assert_eq!(ranks.len(), arrivals.len());
        assert!(ranks == sorted || ranks == reversed, "{ranks:?}");
        assert_eq!(begun.lock().unwrap()[0], Priority::High);
    });
}

/// Servo jobs have a slot that nothing else takes.
#[test]
fn servo_jobs_find_their_slot_free() {
    schedules(|| {
        let pool = pool(1, 1, 4, 2);
        let door = Arc::new(Door::default());
        let mut others: Vec<_> = (0..3)
            .map(|n| {
                let door = Arc::clone(&door);
                let hold = move |_: Turn| {
                    while !door.0.load(Ordering::SeqCst) {
                        shuttle::thread::yield_now();
                    }
                };
                pool.submit(&endless(), &order(Priority::High, n), None, hold).unwrap()
            })
            .collect();
        let mut servo = pool.submit(&endless(), &order(Priority::Servo, 7), None, |_| ()).unwrap();
        block_on(servo.wait()).unwrap();
        door.0.store(true, Ordering::SeqCst);
        others.iter_mut().for_each(|ticket| block_on(ticket.wait()).unwrap());
    });
}

/// A pool that ends while calls come in answers each of them, and its threads end.
#[test]
fn the_end_answers_everybody() {
    schedules(|| {
        let pool = pool(2, 0, 4, 2);
        let callers: Vec<_> = (0..4)
            .map(|n| {
                let pool = Arc::clone(&pool);
                shuttle::thread::spawn(move || {
                    let job = |_: Turn| shuttle::thread::yield_now();
                    match pool.submit(&endless(), &order(Priority::Normal, n), None, job) {
                        Ok(mut ticket) => {
                            let end = block_on(ticket.wait());
                            assert!(matches!(end, Ok(()) | Err(PoolError::Closed)), "{end:?}");
                        }
                        Err(error) => assert_eq!(error, PoolError::Closed),
                    }
                })
            })
            .collect();
        let closer = Arc::clone(&pool);
        let closer = shuttle::thread::spawn(move || closer.close());
        callers.into_iter().for_each(|caller| caller.join().unwrap());
        closer.join().unwrap();
        assert_eq!(pool.waiting(), 0);
    });
}

/// A job that panics is answered, and its slot takes the next one.
#[test]
fn a_panic_costs_no_slot() {
    schedules(|| {
        let pool = pool(1, 0, 4, 2);
        let mut bad =
            pool.submit(&endless(), &order(Priority::Normal, 1), None, |_| panic!("on purpose")).unwrap();
        let mut good = pool.submit(&endless(), &order(Priority::Normal, 2), None, |_| 3).unwrap();
        let bad: Result<(), _> = block_on(bad.wait());
        assert_eq!(bad, Err(PoolError::Panicked));
        assert_eq!(block_on(good.wait()), Ok(3));
    });
}
