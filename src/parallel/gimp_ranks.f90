!> Ranks: processes that share one run, each with its own part of the particles and of the grid.
!>
!> The words of this module have three bodies, chosen by the program that is linked: one process alone (`serial`), processes that
!> send messages (`mpi`), images of coarrays (`coarray`). Nothing outside this room knows which. All ranks must call a
!> collective procedure, in the same order. Everything travels as 64-bit words; other types are views of those.
!> What it costs is counted in gimp_traffic.
module gimp_ranks
  use gimp_common_kinds, only: i8
  implicit none(type, external)
  private
  public :: this_rank, ranks, backend, channel_t
  public :: start_ranks, end_ranks, end_all_ranks, wait_for_ranks
  public :: share_words, gather_words, sum_words, largest_words, words_before, reduce_sums, exchange_words
  public :: open_channel, close_channel, start_exchange, finish_exchange

  integer, protected :: this_rank = 0 !! from 0
  integer, protected :: ranks = 1
  character(len=7), protected :: backend = "serial" !! serial, mpi, coarray

  !> Messages that go between the same ranks again and again: pads of blocks at borders
  type :: channel_t
    integer, allocatable :: to(:), from(:) !! ranks
    integer(i8), allocatable :: to_first(:), from_first(:) !! (messages + 1) where each has its room in its buffer, in words from 1
    integer(i8), allocatable :: to_words(:) !! words of each message this time, at most its room
    integer(i8), allocatable :: from_words(:) !! words that came
    integer(i8), pointer, contiguous :: out(:) => null(), in(:) => null() !! the buffers
    integer, allocatable :: request(:) !! of messages under way; for `mpi`
    integer(i8), allocatable :: place(:) !! of each message in the mailbox of the other rank; for `coarray`
    logical :: under_way = .false.
  end type channel_t

  interface
    !> Join the other ranks; every program does so before anything else
    module subroutine start_ranks()
    end subroutine start_ranks

    !> Leave in good order, with an exit code. Collective; does not come back
    module subroutine end_ranks(code)
      integer, intent(in) :: code
    end subroutine end_ranks

    !> End every rank at once, whatever the others are doing; does not come back
    module subroutine end_all_ranks(code)
      integer, intent(in) :: code
    end subroutine end_all_ranks

    !> Nobody goes on before all have come here
    module subroutine wait_for_ranks()
    end subroutine wait_for_ranks

    !> All get what `root` has
    module subroutine share_words(root, words)
      integer, intent(in) :: root
      integer(i8), intent(inout), contiguous, target :: words(:)
    end subroutine share_words

    !> All get what each has: as many words from every rank
    module subroutine gather_words(mine, all)
      integer(i8), intent(in), contiguous, target :: mine(:)
      integer(i8), intent(out), contiguous, target :: all(:, 0:) !! (word, rank)
    end subroutine gather_words

    !> Sums over all ranks
    module subroutine sum_words(words)
      integer(i8), intent(inout), contiguous, target :: words(:)
    end subroutine sum_words

    !> Largest over all ranks
    module subroutine largest_words(words)
      integer(i8), intent(inout), contiguous, target :: words(:)
    end subroutine largest_words

    !> Sums over the ranks before this one
    module subroutine words_before(words)
      integer(i8), intent(inout), contiguous, target :: words(:)
    end subroutine words_before

    !> Merge exact sums of all ranks (gimp_exact_sum), as they are packed
    module subroutine reduce_sums(words)
      integer(i8), intent(inout), contiguous, target :: words(:, :) !! (words of a sum, sum)
    end subroutine reduce_sums

    !> Lists of any length from every rank to every rank. `from` is in the order of ranks.
    module subroutine exchange_words(to_count, to, from_count, from)
      integer(i8), intent(in), contiguous, target :: to_count(0:) !! words for each rank; `to` holds them in the order of ranks
      integer(i8), intent(in), contiguous, target :: to(:)
      integer(i8), intent(out), contiguous, target :: from_count(0:)
      integer(i8), allocatable, intent(out), target :: from(:)
    end subroutine exchange_words

    !> Make a channel ready: `to`, `from`, `to_first` and `from_first` are set, sizes agree on both sides. Collective
    module subroutine open_channel(channel)
      type(channel_t), intent(inout) :: channel
    end subroutine open_channel

    !> Give its buffers back
    module subroutine close_channel(channel)
      type(channel_t), intent(inout) :: channel
    end subroutine close_channel

    !> Send what stands in `out`, `to_words` of each message. Collective; `out` and `in` are left alone until `finish_exchange`
    module subroutine start_exchange(channel)
      type(channel_t), intent(inout) :: channel
    end subroutine start_exchange

    !> Wait until all messages are there. Collective
    module subroutine finish_exchange(channel)
      type(channel_t), intent(inout) :: channel
    end subroutine finish_exchange
  end interface

end module gimp_ranks
