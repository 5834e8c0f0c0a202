!> What a rank knows of its border: which keys each rank owns, and which parts of pads it gives and gets.
module gimp_border
  use gimp_kinds, only: i8
  use gimp_hash_table, only: hash_table_t
  use gimp_ranks, only: channel_t
  implicit none(type, external)
  private
  public :: border_t, parts_t, repartition_balanced, repartition_always, repartition_never

  integer, parameter :: repartition_balanced = 1 !! when the imbalance of work passes its limit
  integer, parameter :: repartition_always = 2 !! at every sort, to other cuts each time: for tests
  integer, parameter :: repartition_never = 3

  !> Parts of pads that go to one rank after the other
  type :: parts_t
    integer, allocatable :: first(:) !! (messages + 1) first part of each message
    integer, allocatable :: block(:) !! (part)
    integer, allocatable :: low(:, :), high(:, :) !! (3, part) nodes of the pad, from the first node of the block
  end type parts_t

  type :: border_t
    integer(i8), allocatable :: cut(:) !! (0:ranks) rank r owns the keys from cut(r) to below cut(r + 1)
    integer, allocatable :: ghost_rank(:) !! (ghost) who owns it
    type(hash_table_t) :: ghost_of !! key -> number of a ghost from 1
    logical :: always_whole = .false. !! all nodes of slots near blocks of this rank are wanted complete, always: loads at points
    logical :: whole = .false. !! they are, since the last sort: some supports are wide
    type(channel_t) :: channel
    type(parts_t) :: give, get
    ! balance of work
    integer :: repartition = repartition_balanced
    real :: most_imbalance = 1.1 !! largest work of a rank over the mean
    integer(i8) :: repartitions = 0, sorts = 0
    real :: best = 1.0 !! imbalance that the last cuts looked for would have left
    integer(i8) :: tried = 0 !! the sort at which that was
    integer(i8) :: migrated = 0 !! particles that changed their rank at sorts, as far as they left this one
    integer(i8) :: migrated_words = 0, moved_words = 0 !! of such messages, sent by this rank
    real :: imbalance = 1.0, worst_imbalance = 1.0 !! after the last sort, and the largest
    real :: crowding = 1.0, worst_crowding = 1.0 !! the same of particles: largest number of a rank over the mean
  end type border_t

end module gimp_border
