//! Divides frames at common positions into volumes of one time, echo, phase and so on: by the
//! attributes that differ, never by the names of files.

use super::frame::{Frame, KeyValue};
use super::time_keys::{ACQUISITION_NUMBER, ACQUISITION_TIME, INSTANCE_NUMBER, KEYS};
use serde_json::{Value, json};
use std::cmp::Ordering;
use std::collections::{HashMap, HashSet};

/// Smallest number of slices of a volume, as a fraction of those of the largest one; fewer are
/// repeated slices.
const SMALLEST_VOLUME: f64 = 0.5;

/// How volumes at one place are told apart.
#[derive(Clone, Debug, Default)]
pub struct TimePoints {
    /// The attributes that differ.
    names: Vec<&'static str>,
    /// Their values, for each volume.
    values: Vec<Vec<KeyValue>>,
}

impl TimePoints {
    /// For messages: the attributes and their values.
    pub fn described(&self) -> Option<String> {
        const MOST: usize = 6;
        if self.names.is_empty() {
            return None;
        }
        let of_each: Vec<String> = self
            .values
            .iter()
            .take(MOST)
            .map(|values| {
                values
                    .iter()
                    .map(KeyValue::to_string)
                    .collect::<Vec<_>>()
                    .join(" and ")
            })
            .collect();
        let more = if self.values.len() > MOST { ", ..." } else { "" };
        Some(format!(
            "{}: {}{more}",
            self.names.join(" and "),
            of_each.join(", ")
        ))
    }

    /// For `info`: the attributes and values of each volume.
    pub fn json(&self) -> Option<Value> {
        let entry = |values: &Vec<KeyValue>| {
            let pairs = self.names.iter().zip(values);
            Value::Object(pairs.map(|(n, v)| ((*n).to_owned(), v.json())).collect())
        };
        (!self.names.is_empty()).then(|| json!(self.values.iter().map(entry).collect::<Vec<_>>()))
    }
}

/// Frames divided into volumes.
pub struct Division {
    /// Indices of the frames of each volume.
    pub volumes: Vec<Vec<usize>>,
    pub by: TimePoints,
    /// Frames at the same position as another one of their volume, or of too small a volume.
    pub duplicates: Vec<usize>,
    /// Whether frames could not be told apart by any attribute.
    pub ambiguous: bool,
}

/// The value of a frame's key.
fn value(frame: &Frame, key: usize) -> Option<&KeyValue> {
    frame
        .keys
        .iter()
        .find(|(k, _)| usize::from(*k) == key)
        .map(|(_, v)| v)
}

fn order(a: Option<&KeyValue>, b: Option<&KeyValue>) -> Ordering {
    match (a, b) {
        (Some(a), Some(b)) => a.order(b),
        (a, b) => a.is_some().cmp(&b.is_some()),
    }
}

/// The frames being divided, their stacks (frames at one position), and groups so far.
struct Divider<'a> {
    frames: &'a [Frame],
    stack: &'a [usize],
    group: Vec<usize>,
    /// Number of frames in the largest stack.
    most: usize,
}

impl Divider<'_> {
    /// Whether each group has at most one frame of each stack.
    fn is_done(&self) -> bool {
        let mut seen = HashSet::new();
        (0..self.frames.len()).all(|n| seen.insert((self.stack[n], self.group[n])))
    }

    /// The rank of each frame's value of a key among all distinct ones, and their number.
    fn ranks(&self, key: usize) -> (Vec<usize>, usize) {
        let mut by_value: Vec<usize> = (0..self.frames.len()).collect();
        let of = |n: usize| value(&self.frames[n], key);
        by_value.sort_by(|a, b| order(of(*a), of(*b)));
        let mut ranks = vec![0; self.frames.len()];
        let mut rank = 0;
        for pair in by_value.windows(2) {
            rank += usize::from(order(of(pair[0]), of(pair[1])).is_ne());
            ranks[pair[1]] = rank;
        }
        if KEYS[key].is_unordered {
            self.rank_by_first(&mut ranks, rank + 1);
        }
        (ranks, rank + 1)
    }

    /// Ranks values that have no order by the first frame that has them: by its acquisition, then its
    /// instance number.
    fn rank_by_first(&self, ranks: &mut [usize], count: usize) {
        let mut first = vec![[f64::INFINITY; 3]; count];
        for (frame, rank) in self.frames.iter().zip(&*ranks) {
            let numbers = [ACQUISITION_NUMBER, ACQUISITION_TIME, INSTANCE_NUMBER].map(|name| {
                let value = frame
                    .keys
                    .iter()
                    .find(|(k, _)| KEYS[usize::from(*k)].name == name);
                match value {
                    Some((_, KeyValue::Number(n))) => *n,
                    _ => f64::INFINITY,
                }
            });
            for (least, number) in first[*rank].iter_mut().zip(numbers) {
                *least = least.min(number);
            }
        }
        let mut by_first: Vec<usize> = (0..count).collect();
        by_first.sort_by(|a, b| {
            let pairs = first[*a].iter().zip(&first[*b]);
            let order = pairs.map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne());
            order.unwrap_or(Ordering::Equal)
        });
        let mut new = vec![0; count];
        for (n, rank) in by_first.into_iter().enumerate() {
            new[rank] = n;
        }
        ranks.iter_mut().for_each(|r| *r = new[*r]);
    }

    /// Divides groups by the values of a key, if these tell frames of a stack apart and are not
    /// more than frames of a stack.
    fn divide_by_values(&mut self, key: usize) -> bool {
        let (ranks, distinct) = self.ranks(key);
        if distinct < 2 || distinct > self.most {
            return false;
        }
        let mut first: HashMap<(usize, usize), usize> = HashMap::new();
        let differs = (0..self.frames.len())
            .any(|n| *first.entry((self.stack[n], self.group[n])).or_insert(ranks[n]) != ranks[n]);
        if !differs {
            return false;
        }
        let mut pairs: Vec<(usize, usize)> = (0..ranks.len()).map(|n| (self.group[n], ranks[n])).collect();
        pairs.sort_unstable();
        pairs.dedup();
        if pairs.len() > self.most {
            return false;
        }
        for (n, rank) in ranks.iter().enumerate() {
            let pair = (self.group[n], *rank);
            self.group[n] = pairs.partition_point(|p| *p < pair);
        }
        true
    }

    /// The frames of each group and stack.
    fn cells(&self) -> HashMap<(usize, usize), Vec<usize>> {
        let mut cells: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
        for n in 0..self.frames.len() {
            cells.entry((self.group[n], self.stack[n])).or_default().push(n);
        }
        cells
    }

    /// Divides groups by the order of a key's values, if they differ within each stack.
    fn divide_by_order(&mut self, key: usize) -> bool {
        let (ranks, _) = self.ranks(key);
        let cells = self.cells();
        let distinct = cells.values().all(|cell| {
            let mut seen = HashSet::new();
            cell.iter().all(|n| seen.insert(ranks[*n]))
        });
        if !distinct {
            return false;
        }
        let mut place = vec![0; self.frames.len()];
        let even = cells.values().map(Vec::len).collect::<HashSet<_>>().len() == 1;
        if even {
            for mut cell in cells.into_values() {
                cell.sort_by_key(|n| ranks[*n]);
                for (rank, n) in cell.into_iter().enumerate() {
                    place[n] = rank;
                }
            }
        } else {
            // One volume after the other: the next begins where a position repeats.
            let mut all: Vec<usize> = (0..self.frames.len()).collect();
            all.sort_by_key(|n| (self.group[*n], ranks[*n]));
            let (mut current, mut seen, mut last) = (0, HashSet::new(), usize::MAX);
            for n in all {
                if self.group[n] != last {
                    (current, last) = (0, self.group[n]);
                    seen.clear();
                } else if seen.contains(&self.stack[n]) {
                    current += 1;
                    seen.clear();
                }
                seen.insert(self.stack[n]);
                place[n] = current;
            }
        }
        self.refine(&place);
        true
    }

    fn refine(&mut self, place: &[usize]) {
        let mut pairs: Vec<(usize, usize)> = (0..place.len()).map(|n| (self.group[n], place[n])).collect();
        pairs.sort_unstable();
        pairs.dedup();
        for (n, p) in place.iter().enumerate() {
            let pair = (self.group[n], *p);
            self.group[n] = pairs.partition_point(|q| *q < pair);
        }
    }

    /// Divides groups by instance number, else in the given order.
    fn divide_anyhow(&mut self) {
        let mut place = vec![0; self.frames.len()];
        for mut cell in self.cells().into_values() {
            cell.sort_by(|a, b| {
                let of = |n: usize| self.frames[n].instance.unwrap_or(0.0);
                of(*a).total_cmp(&of(*b)).then(a.cmp(b))
            });
            for (rank, n) in cell.into_iter().enumerate() {
                place[n] = rank;
            }
        }
        self.refine(&place);
    }
}

/// Divides frames, given the stack of each, into volumes that have at most one frame of each stack.
pub fn divide(frames: &[Frame], stack: &[usize]) -> Division {
    let mut sizes: HashMap<usize, usize> = HashMap::new();
    for s in stack {
        *sizes.entry(*s).or_default() += 1;
    }
    let mut divider = Divider {
        frames,
        stack,
        group: vec![0; frames.len()],
        most: sizes.values().copied().max().unwrap_or(1),
    };
    let mut keys = Vec::new();
    for key in 0..KEYS.len() {
        if divider.is_done() {
            break;
        }
        if divider.divide_by_values(key) {
            keys.push(key);
        }
    }
    let mut ambiguous = false;
    if !divider.is_done() {
        let by_order = (0..KEYS.len())
            .filter(|k| KEYS[*k].runs_on)
            .find(|k| divider.divide_by_order(*k));
        match by_order {
            Some(key) => keys.push(key),
            None => {
                divider.divide_anyhow();
                ambiguous = true;
            }
        }
    }
    volumes(&divider, &keys, ambiguous)
}

/// The volumes of a finished division.
fn volumes(divider: &Divider, keys: &[usize], ambiguous: bool) -> Division {
    let frames = divider.frames;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (n, group) in divider.group.iter().enumerate() {
        if groups.len() <= *group {
            groups.resize_with(group + 1, Vec::new);
        }
        groups[*group].push(n);
    }
    groups.retain(|g| !g.is_empty());
    let largest = groups.iter().map(Vec::len).max().unwrap_or(0);
    let enough = |g: &Vec<usize>| g.len() as f64 >= SMALLEST_VOLUME * largest as f64;
    let (volumes, few): (Vec<Vec<usize>>, Vec<Vec<usize>>) = groups.into_iter().partition(enough);
    let mut duplicates = few.concat();
    let mut volumes = volumes;
    if let [only] = &mut volumes[..] {
        // Positions that only the other frames have belong to the one volume.
        let mut there: HashSet<usize> = only.iter().map(|n| divider.stack[*n]).collect();
        duplicates.retain(|n| {
            let new = there.insert(divider.stack[*n]);
            if new {
                only.push(*n);
            }
            !new
        });
        only.sort_unstable();
    }
    let mut by = TimePoints::default();
    if volumes.len() > 1 {
        by.names = keys.iter().map(|k| KEYS[*k].name).collect();
        by.values = volumes
            .iter()
            .map(|v| {
                let of = |k: &usize| value(&frames[v[0]], *k).cloned();
                keys.iter()
                    .map(|k| of(k).unwrap_or_else(|| KeyValue::Text("not stated".into())))
                    .collect()
            })
            .collect();
        for (n, _) in keys.iter().enumerate().filter(|(_, k)| KEYS[**k].relative) {
            from_first(&mut by.values, n);
        }
    }
    Division {
        volumes,
        by,
        duplicates,
        ambiguous,
    }
}

/// Makes the numbers of the n-th attribute count from the first volume's.
fn from_first(values: &mut [Vec<KeyValue>], n: usize) {
    let Some(KeyValue::Number(first)) = values.first().map(|v| v[n].clone()) else {
        return;
    };
    for volume in values {
        if let KeyValue::Number(number) = &mut volume[n] {
            // Times are stated to the microsecond.
            *number = ((*number - first) * 1e6).round() / 1e6;
        }
    }
}
