!> Images of coarrays, numbered from 1 where ranks begin at 0. What goes from one to another is put into the mailbox of the other,
!> at a place that both know: all come together, put, come together again, and take what is there.
submodule(gimp_ranks) gimp_ranks_coarray
  use, intrinsic :: iso_fortran_env, only: error_unit, output_unit
  use gimp_common_kinds, only: dp
  use gimp_timer, only: seconds_now
  use gimp_traffic, only: book, of_pads, of_lists, of_all
  use gimp_exact_sum, only: words_of_sum, merge_sums
  use gimp_coarray_images, only: start_images, end_images, abort_images, sync_images, share_over_images, sum_over_images, &
                         largest_over_images, make_room, put_words, take_words
  implicit none(type, external)
contains

  module procedure start_ranks
    call start_images(this_rank, ranks)
    this_rank = this_rank - 1
    backend = "coarray"
  end procedure start_ranks

  module procedure end_ranks
    flush (output_unit) ! before anyone leaves: mpirun kills the others once one has left with another code than 0
    flush (error_unit)
    call sync_images()
    call end_images()
    stop code, quiet=.true.
  end procedure end_ranks

  module procedure end_all_ranks
    flush (output_unit)
    flush (error_unit)
    call abort_images(code)
    stop code, quiet=.true. ! not reached
  end procedure end_all_ranks

  module procedure wait_for_ranks
    real(dp) :: since
    since = seconds_now()
    call sync_images()
    call book(of_all, 1_i8, 0_i8, since)
  end procedure wait_for_ranks

  module procedure share_words
    real(dp) :: since
    since = seconds_now()
    call share_over_images(root + 1, words)
    call book(of_all, 1_i8, merge(size(words, kind=i8), 0_i8, this_rank == root), since)
  end procedure share_words

  module procedure gather_words
    real(dp) :: since
    since = seconds_now()
    call gather(mine, all)
    call book(of_all, 1_i8, size(mine, kind=i8), since)
  end procedure gather_words

  !> The same without an entry in the books: words of others are zero in a sum
  subroutine gather(mine, all)
    integer(i8), intent(in), contiguous :: mine(:)
    integer(i8), intent(out), contiguous, target :: all(:, 0:) !! (word, rank)
    integer(i8), pointer, contiguous :: flat(:)
    all = 0
    all(:, this_rank) = mine
    flat(1:size(all)) => all
    call sum_over_images(flat)
  end subroutine gather

  module procedure sum_words
    real(dp) :: since
    since = seconds_now()
    call sum_over_images(words)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure sum_words

  module procedure largest_words
    real(dp) :: since
    since = seconds_now()
    call largest_over_images(words)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure largest_words

  module procedure words_before
    integer(i8) :: of_ranks(size(words), 0:ranks - 1)
    real(dp) :: since
    since = seconds_now()
    call gather(words, of_ranks)
    words = sum(of_ranks(:, :this_rank - 1), dim=2)
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure words_before

  module procedure reduce_sums
    integer(i8) :: of_ranks(size(words), 0:ranks - 1)
    real(dp) :: since
    integer :: r
    since = seconds_now()
    call gather(reshape(words, [size(words)]), of_ranks)
    words = reshape(of_ranks(:, 0), shape(words))
    do r = 1, ranks - 1
      call merge_sums(words, reshape(of_ranks(:, r), [words_of_sum, size(words, 2)]))
    end do
    call book(of_all, 1_i8, size(words, kind=i8), since)
  end procedure reduce_sums

  module procedure exchange_words
    real(dp) :: since
    integer(i8) :: n
    since = seconds_now()
    call exchange(to_count, to, from_count, from)
    n = to_count(this_rank)
    call book(of_lists, int(count(to_count > 0), i8) - merge(1, 0, n > 0), sum(to_count) - n, since)
  end procedure exchange_words

  !> The same without an entry in the books
  subroutine exchange(to_count, to, from_count, from)
    integer(i8), intent(in), contiguous :: to_count(0:), to(:)
    integer(i8), intent(out) :: from_count(0:)
    integer(i8), allocatable, intent(out) :: from(:)
    integer(i8) :: counts(0:ranks - 1, 0:ranks - 1) !! (to, from)
    integer(i8) :: first
    integer :: r
    call gather(to_count, counts)
    from_count = counts(this_rank, :)
    call make_room(sum(from_count))
    call sync_images() ! everybody has read what was there before
    first = 1
    do r = 0, ranks - 1
      call put_words(to(first:first + to_count(r) - 1), r + 1, 1 + sum(counts(r, :this_rank - 1)))
      first = first + to_count(r)
    end do
    call sync_images()
    allocate (from(sum(from_count)))
    call take_words(from, 1_i8)
  end subroutine exchange

  !> Each message has one word more in the mailbox: its length
  module procedure open_channel
    integer(i8), allocatable :: places(:)
    integer(i8) :: count_to(0:ranks - 1), count_from(0:ranks - 1), at(0:ranks - 1)
    integer, allocatable :: order(:)
    integer :: k, r
    associate (to => channel%to_first(size(channel%to) + 1), from => channel%from_first(size(channel%from) + 1))
      allocate (channel%out(to - 1), channel%in(from - 1))
    end associate
    allocate (channel%to_words(size(channel%to)), channel%from_words(size(channel%from)), channel%place(size(channel%to)), source=0_i8)
    count_to = [(int(count(channel%from == r), i8), r=0, ranks - 1)] ! places are told to those who send
    order = [integer :: (pack([(k, k=1, size(channel%from))], channel%from == r), r=0, ranks - 1)]
    call exchange(count_to, channel%from_first(order) + order - 1, count_from, places)
    at = [(1 + sum(count_from(:r - 1)), r=0, ranks - 1)]
    do k = 1, size(channel%to)
      channel%place(k) = places(at(channel%to(k)))
      at(channel%to(k)) = at(channel%to(k)) + 1
    end do
    call make_room(size(channel%in, kind=i8) + size(channel%from))
  end procedure open_channel

  module procedure close_channel
    call finish_exchange(channel)
    if (associated(channel%out)) deallocate (channel%out, channel%in)
    channel = channel_t()
  end procedure close_channel

  module procedure start_exchange
    channel%under_way = .true. ! other channels and lists may use the mailbox until all finish this one
  end procedure start_exchange

  module procedure finish_exchange
    real(dp) :: since
    integer(i8) :: at, length(1)
    integer :: k
    if (.not. channel%under_way) return
    since = seconds_now()
    call sync_images() ! everybody has read what was there before
    do k = 1, size(channel%to)
      at = channel%to_first(k)
      call put_words([channel%to_words(k), channel%out(at:at + channel%to_words(k) - 1)], channel%to(k) + 1, channel%place(k))
    end do
    call sync_images()
    do k = 1, size(channel%from)
      at = channel%from_first(k)
      call take_words(length, at + k - 1)
      call take_words(channel%in(at:at + length(1) - 1), at + k)
      channel%from_words(k) = length(1)
    end do
    channel%under_way = .false.
    call book(of_pads, int(size(channel%to), i8), sum(channel%to_words), since)
  end procedure finish_exchange

end submodule gimp_ranks_coarray
