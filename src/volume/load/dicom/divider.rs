//! Frames on their way into volumes: the groups that they form so far, and the ways to divide these.

use super::frame::{Frame, KeyValue};
use super::time_keys::{ACQUISITION_NUMBER, ACQUISITION_TIME, INSTANCE_NUMBER, KEYS};
use dicom_core::Tag;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

/// Values differ clearly if their distance is this many times that of others which do not.
const CLEARLY: f64 = 5.0;
/// Slices are evenly spaced up to this fraction of their mean distance.
const EVEN: f64 = 0.1;
/// Fewer slices are not seen to be evenly spaced.
const FEWEST_SLICES: usize = 3;
/// Volumes overlap if they share this fraction of the smaller one's extent.
const OVERLAP: f64 = 0.5;

/// The frames being divided, their stacks (frames at one position), and their groups so far.
pub struct Divider<'a> {
    pub frames: &'a [Frame],
    pub stack: &'a [usize],
    /// Position of each frame along the normal, mm.
    at: &'a [f64],
    group: Vec<usize>,
    /// Number of frames in the largest stack.
    most: usize,
}

fn order(a: Option<&KeyValue>, b: Option<&KeyValue>) -> Ordering {
    match (a, b) {
        (Some(a), Some(b)) => a.order(b),
        (a, b) => a.is_some().cmp(&b.is_some()),
    }
}

impl<'a> Divider<'a> {
    /// All frames in one group.
    pub fn new(frames: &'a [Frame], stack: &'a [usize], at: &'a [f64]) -> Self {
        let mut sizes: HashMap<usize, usize> = HashMap::new();
        for s in stack {
            *sizes.entry(*s).or_default() += 1;
        }
        Self {
            frames,
            stack,
            at,
            group: vec![0; frames.len()],
            most: sizes.values().copied().max().unwrap_or(1),
        }
    }

    /// The value of a frame's key.
    pub fn value(&self, frame: usize, key: usize) -> Option<&KeyValue> {
        let keys = &self.frames[frame].keys;
        let found = keys.binary_search_by_key(&key, |(k, _)| usize::from(*k));
        found.ok().map(|n| &keys[n].1)
    }

    /// Whether the value of a key is the same for all frames.
    fn is_constant(&self, key: usize) -> bool {
        let first = self.value(0, key);
        (1..self.frames.len()).all(|n| self.value(n, key) == first)
    }

    /// Whether each group has at most one frame of each stack.
    pub fn is_done(&self) -> bool {
        let mut seen = HashSet::new();
        (0..self.frames.len()).all(|n| seen.insert((self.stack[n], self.group[n])))
    }

    /// The frames of each group.
    pub fn groups(&self) -> Vec<Vec<usize>> {
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (n, group) in self.group.iter().enumerate() {
            groups.entry(*group).or_default().push(n);
        }
        groups.into_values().collect()
    }

    /// As [`Self::ranks`], but numbers that scatter around a few count as these.
    fn clear_ranks(&self, key: usize) -> (Vec<usize>, usize) {
        let (ranks, distinct) = self.ranks(key);
        let clusters = (distinct > self.most).then(|| self.clusters(key)).flatten();
        clusters.unwrap_or((ranks, distinct))
    }

    /// The rank of each frame's value of a key among all distinct ones, and their number.
    fn ranks(&self, key: usize) -> (Vec<usize>, usize) {
        let of = |n: usize| self.value(n, key);
        let by_value = self.by_value(key);
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

    /// The frames in the order of a key's values.
    fn by_value(&self, key: usize) -> Vec<usize> {
        let of = |n: usize| self.value(n, key);
        let mut by_value: Vec<usize> = (0..self.frames.len()).collect();
        by_value.sort_by(|a, b| order(of(*a), of(*b)));
        by_value
    }

    /// Clusters of numbers that are clearly apart, at most as many as frames in a stack.
    fn clusters(&self, key: usize) -> Option<(Vec<usize>, usize)> {
        let by_value = self.by_value(key);
        let number = |n: &usize| match self.value(*n, key) {
            Some(KeyValue::Number(v)) => Some(*v),
            _ => None,
        };
        let values: Vec<f64> = by_value.iter().map(number).collect::<Option<_>>()?;
        let mut gaps: Vec<f64> = values
            .windows(2)
            .map(|w| w[1] - w[0])
            .filter(|g| *g > 0.0)
            .collect();
        gaps.sort_by(|a, b| b.total_cmp(a));
        // The number of gaps after which they become clearly smaller.
        let ratio = |n: &usize| gaps[n - 1] / gaps[*n];
        let best = (1..self.most.min(gaps.len())).max_by(|a, b| ratio(a).total_cmp(&ratio(b)))?;
        if ratio(&best) < CLEARLY {
            return None;
        }
        let limit = gaps[best - 1];
        let mut ranks = vec![0; by_value.len()];
        let mut rank = 0;
        for (pair, w) in by_value.windows(2).zip(values.windows(2)) {
            rank += usize::from(w[1] - w[0] >= limit);
            ranks[pair[1]] = rank;
        }
        Some((ranks, rank + 1))
    }

    /// Ranks values that have no order by the first frame that has them: by its acquisition, then its
    /// instance number.
    fn rank_by_first(&self, ranks: &mut [usize], count: usize) {
        let named = |frame: &Frame, name: &str| {
            let value = frame
                .keys
                .iter()
                .find(|(k, _)| KEYS[usize::from(*k)].name == name);
            match value {
                Some((_, KeyValue::Number(n))) => *n,
                _ => f64::INFINITY,
            }
        };
        let mut first = vec![[f64::INFINITY; 3]; count];
        for (frame, rank) in self.frames.iter().zip(&*ranks) {
            let numbers = [ACQUISITION_NUMBER, ACQUISITION_TIME, INSTANCE_NUMBER].map(|n| named(frame, n));
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

    /// Divides groups by a key whose values part evenly spaced slices that overlap: volumes whose
    /// planes need not coincide.
    pub fn divide_overlapping(&mut self, key: usize) -> bool {
        if self.is_constant(key) {
            return false;
        }
        let (ranks, distinct) = self.clear_ranks(key);
        if distinct < 2 || 2 * distinct > self.frames.len() {
            return false;
        }
        let mut parts: BTreeMap<(usize, usize), BTreeSet<usize>> = BTreeMap::new();
        for (n, rank) in ranks.iter().enumerate() {
            parts.entry((self.group[n], *rank)).or_default().insert(n);
        }
        let positions: Vec<(usize, Vec<f64>)> = parts
            .iter()
            .map(|((group, _), frames)| (*group, self.distinct_positions(frames)))
            .collect();
        let overlap = |a: &[f64], b: &[f64]| {
            let extent = |v: &[f64]| v[v.len() - 1] - v[0];
            let shared = a[a.len() - 1].min(b[b.len() - 1]) - a[0].max(b[0]);
            shared >= OVERLAP * extent(a).min(extent(b))
        };
        if positions
            .iter()
            .any(|(_, p)| p.len() < FEWEST_SLICES || !is_even(p))
        {
            return false;
        }
        let pairs_overlap = positions
            .windows(2)
            .filter(|w| w[0].0 == w[1].0)
            .all(|w| overlap(&w[0].1, &w[1].1));
        let parts_a_group = positions.windows(2).any(|w| w[0].0 == w[1].0);
        if pairs_overlap && parts_a_group {
            self.refine(&ranks);
        }
        pairs_overlap && parts_a_group
    }

    /// Positions of frames, one of each stack; frames are sorted along the normal.
    fn distinct_positions(&self, frames: &BTreeSet<usize>) -> Vec<f64> {
        let mut last = None;
        frames
            .iter()
            .filter(|n| last.replace(self.stack[**n]) != Some(self.stack[**n]))
            .map(|n| self.at[*n])
            .collect()
    }

    /// Divides groups by the values of a key, if these tell frames of a stack apart and are not
    /// more than frames of a stack.
    pub fn divide_by_values(&mut self, key: usize) -> bool {
        if self.is_constant(key) {
            return false;
        }
        let missing: Vec<usize> = (0..self.frames.len())
            .filter(|n| self.value(*n, key).is_none())
            .collect();
        let stacks = self.stack.last().map_or(0, |s| s + 1);
        let (mut ranks, mut distinct) = self.clear_ranks(key);
        // A few frames that lack the attribute take the place that is free.
        let few = !missing.is_empty() && 2 * missing.len() < stacks;
        if few && self.fill_places(&mut ranks, &missing) {
            distinct = ranks.iter().collect::<HashSet<_>>().len();
        }
        self.divide_by_ranks(&ranks, distinct)
    }

    /// Gives frames without a value the only value that no frame of their stack and group has;
    /// false if there is none, or more than one.
    fn fill_places(&self, ranks: &mut [usize], missing: &[usize]) -> bool {
        let all: BTreeSet<usize> = (0..ranks.len())
            .filter(|n| !missing.contains(n))
            .map(|n| ranks[n])
            .collect();
        let mut filled = Vec::new();
        for &n in missing {
            let taken: BTreeSet<usize> = (0..ranks.len())
                .filter(|m| self.stack[*m] == self.stack[n] && self.group[*m] == self.group[n] && *m != n)
                .map(|m| ranks[m])
                .collect();
            let free: Vec<usize> = all.difference(&taken).copied().collect();
            let [only] = free[..] else { return false };
            filled.push((n, only));
        }
        for (n, rank) in filled {
            ranks[n] = rank;
        }
        true
    }

    fn divide_by_ranks(&mut self, ranks: &[usize], distinct: usize) -> bool {
        if distinct < 2 || distinct > self.most {
            return false;
        }
        let mut first: HashMap<(usize, usize), usize> = HashMap::new();
        let differs = (0..self.frames.len())
            .any(|n| *first.entry((self.stack[n], self.group[n])).or_insert(ranks[n]) != ranks[n]);
        let pairs: HashSet<(usize, usize)> = self.group.iter().copied().zip(ranks.iter().copied()).collect();
        let accepted = differs && pairs.len() <= self.most;
        if accepted {
            self.refine(ranks);
        }
        accepted
    }

    /// Divides groups by the first attribute, whatever it is, or the first few, that leave one frame
    /// of each stack in each group, and whole volumes.
    pub fn divide_by_any(&mut self) -> Vec<Tag> {
        let mut tags: Vec<Tag> = self.frames[0].others.iter().map(|(t, _)| *t).collect();
        tags.extend(self.frames[0].own_others.iter().map(|(t, _)| *t));
        // Those of the standard first.
        tags.sort_by_key(|t| (t.0 % 2, *t));
        tags.dedup();
        let before = self.group.clone();
        for tag in &tags {
            if self.divide_by_digests(*tag) && self.has_whole_volumes() {
                return vec![*tag];
            }
            self.group.clone_from(&before);
        }
        let mut used = Vec::new();
        for tag in tags {
            if self.divide_by_digests(tag) {
                used.push(tag);
            }
            if self.has_whole_volumes() {
                return used;
            }
        }
        self.group = before;
        Vec::new()
    }

    /// Whether each group has one frame of most stacks.
    fn has_whole_volumes(&self) -> bool {
        let stacks = self.stack.last().map_or(0, |s| s + 1);
        self.is_done() && self.groups().iter().all(|g| 2 * g.len() >= stacks)
    }

    fn divide_by_digests(&mut self, tag: Tag) -> bool {
        let mut orders: HashMap<Option<u64>, f64> = HashMap::new();
        let mut hashes = Vec::with_capacity(self.frames.len());
        for frame in self.frames {
            let digest = frame.other(tag);
            let hash = digest.map(|d| d.hash);
            orders.entry(hash).or_insert(digest.map_or(0.0, |d| d.order));
            if orders.len() > self.most {
                return false;
            }
            hashes.push(hash);
        }
        let mut sorted: Vec<(Option<u64>, f64)> = orders.into_iter().collect();
        sorted.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let rank = |hash: &Option<u64>| sorted.iter().position(|(h, _)| h == hash).unwrap_or(0);
        let ranks: Vec<usize> = hashes.iter().map(rank).collect();
        self.divide_by_ranks(&ranks, sorted.len())
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
    pub fn divide_by_order(&mut self, key: usize) -> bool {
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

    /// Divides groups by the rank of each frame.
    fn refine(&mut self, ranks: &[usize]) {
        let mut pairs: Vec<(usize, usize)> = self.group.iter().copied().zip(ranks.iter().copied()).collect();
        pairs.sort_unstable();
        pairs.dedup();
        for (n, rank) in ranks.iter().enumerate() {
            let pair = (self.group[n], *rank);
            self.group[n] = pairs.partition_point(|p| *p < pair);
        }
    }

    /// Divides groups by instance number, else in the given order.
    pub fn divide_arbitrarily(&mut self) {
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

/// Whether sorted positions are evenly spaced.
fn is_even(positions: &[f64]) -> bool {
    let mean = (positions[positions.len() - 1] - positions[0]) / (positions.len() - 1) as f64;
    positions
        .windows(2)
        .all(|w| (w[1] - w[0] - mean).abs() <= EVEN * mean)
}
