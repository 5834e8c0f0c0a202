!> The words of working together, on any number of ranks: who gets what from whom
program test_ranks
  use gimp_common_kinds, only: dp, i8
  use gimp_text, only: text_of
  use gimp_exact_sum, only: words_of_sum, wide_sum_t, add_exactly, pack_sum
  use gimp_ranks, only: this_rank, ranks, backend, channel_t, start_ranks, end_ranks, wait_for_ranks, share_words, gather_words, &
                        sum_words, largest_words, words_before, reduce_sums, exchange_words, open_channel, close_channel, &
                        start_exchange, finish_exchange
  use gimp_traffic, only: traffic, of_pads, of_lists, of_all
  use gimp_check, only: begin_suite, suite_failed, check, check_true
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan
  implicit none(type, external)
  integer(i8) :: failed(1)

  call start_ranks()
  call begin_suite("ranks, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  call check_true(this_rank >= 0 .and. this_rank < ranks, "ranks count from zero")
  call test_share()
  call test_gather()
  call test_reductions()
  call test_exact_sums()
  call test_lists()
  call test_long_lists()
  call test_channels()
  call test_two_channels()
  call test_quiet_channel()
  call test_books()
  call wait_for_ranks()
  failed = merge(1, 0, suite_failed())
  call largest_words(failed)
  call end_ranks(int(failed(1)))

contains

  !> From every rank to all, of any length
  subroutine test_share()
    integer(i8), allocatable :: words(:)
    integer :: root, n, k
    do root = 0, ranks - 1
      do n = 0, 3000, 1500
        allocate (words(n), source=-1_i8)
        if (this_rank == root) words = [(value(root, n, k), k=1, n)]
        call share_words(root, words)
        call check_true(all(words == [(value(root, n, k), k=1, n)]), "words of rank "//text_of(root)//" are shared")
        deallocate (words)
      end do
    end do
  end subroutine test_share

  subroutine test_gather()
    integer(i8) :: mine(5), all_words(5, 0:ranks - 1), nothing(0), of_nobody(0, 0:ranks - 1)
    integer :: r, k
    mine = [(value(this_rank, 0, k), k=1, 5)]
    call gather_words(mine, all_words)
    call check_true(all(all_words == reshape([((value(r, 0, k), k=1, 5), r=0, ranks - 1)], [5, ranks])), "each has what all had")
    call gather_words(nothing, of_nobody)
  end subroutine test_gather

  subroutine test_reductions()
    integer(i8) :: words(3), nothing(0)
    integer :: r
    words = [int(this_rank, i8), -2_i8**40, huge(1_i8)/ranks]
    call sum_words(words)
    call check_true(all(words == [ranks*(ranks - 1_i8)/2, -2_i8**40*ranks, ranks*(huge(1_i8)/ranks)]), "sums")
    words = [-10_i8 - this_rank, modulo(this_rank + 1_i8, int(ranks, i8)), merge(huge(1_i8), -huge(1_i8), this_rank == ranks - 1)]
    call largest_words(words)
    call check_true(all(words == [-10_i8, ranks - 1_i8, huge(1_i8)]), "the largest")
    words = [1_i8, 2_i8*this_rank, -3_i8]
    call words_before(words)
    r = this_rank
    call check_true(all(words == [int(r, i8), r*(r - 1_i8), -3_i8*r]), "sums over the ranks before")
    call sum_words(nothing)
    call largest_words(nothing)
    call words_before(nothing)
  end subroutine test_reductions

  !> The same words however the terms are dealt out: in turn, all to the last, and with one that is not a number
  subroutine test_exact_sums()
    integer(i8) :: words(words_of_sum, 3), nothing(words_of_sum, 0)
    type(wide_sum_t) :: mine(3), all(3)
    real(dp) :: term
    integer :: k
    do k = 1, 1000
      term = sin(real(k, dp))*10.0_dp**modulo(7*k, 40)
      call add_exactly(all(1), term)
      if (modulo(k, ranks) == this_rank) call add_exactly(mine(1), term)
      call add_exactly(all(2), -term)
      if (this_rank == ranks - 1) call add_exactly(mine(2), -term)
      call add_exactly(all(3), term)
      if (modulo(k/10, ranks) == this_rank) call add_exactly(mine(3), term)
    end do
    call add_exactly(all(3), ieee_value(1.0_dp, ieee_quiet_nan))
    if (this_rank == 0) call add_exactly(mine(3), ieee_value(1.0_dp, ieee_quiet_nan))
    do k = 1, 3
      words(:, k) = pack_sum(mine(k))
    end do
    call reduce_sums(words)
    call check_true(all_equal(words(:, 1), pack_sum(all(1))), "terms dealt out in turn")
    call check_true(all_equal(words(:, 2), pack_sum(all(2))), "one rank has all terms")
    call check_true(all_equal(words(1:1, 3), [72_i8]), "not a number on one rank")
    call reduce_sums(nothing)
  end subroutine test_exact_sums

  !> Uneven lists, some of them empty, and all empty
  subroutine test_lists()
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable :: to(:), from(:)
    integer :: again, r, k
    do again = 0, 20
      to_count = [(length(this_rank, r, again), r=0, ranks - 1)]
      to = [integer(i8) :: ([(value(this_rank, r, k + again), k=1, int(to_count(r)))], r=0, ranks - 1)]
      from_count = -1
      call exchange_words(to_count, to, from_count, from)
      call check_true(all_equal(from_count, [(length(r, this_rank, again), r=0, ranks - 1)]), "counts of lists")
      call check_true(all_equal(from, [integer(i8) :: ([(value(r, this_rank, k + again), k=1, int(length(r, this_rank, again)))], &
                                                       r=0, ranks - 1)]), "lists in the order of ranks")
    end do
  end subroutine test_lists

  !> Words from one rank to another in round `again`; none at all in the first round, none but to itself in the second
  pure integer(i8) function length(from, to, again)
    integer, intent(in) :: from, to, again
    length = modulo(5_i8*from + 3*to + again, 4_i8)*(10*from + to)
    if (again == 0 .or. (again == 1 .and. from /= to)) length = 0
  end function length

  !> More than what a library sends at once, from the first to the last and back
  subroutine test_long_lists()
    integer, parameter :: n = 300000
    integer(i8) :: to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable :: to(:), from(:)
    integer :: other, k
    to_count = 0
    other = ranks - 1 - this_rank
    if (this_rank == 0 .or. other == 0) to_count(other) = n + this_rank
    to = [(value(this_rank, other, k), k=1, int(to_count(other)))]
    call exchange_words(to_count, to, from_count, from)
    to_count(other) = merge(n + other, 0, to_count(other) > 0)
    call check_true(all_equal(from_count, to_count), "counts of long lists")
    call check_true(all_equal(from, [(value(other, this_rank, k), k=1, int(to_count(other)))]), "long lists")
  end subroutine test_long_lists

  !> Two messages to the next rank and one to the one before, of other lengths every time, again and again, also empty
  subroutine test_channels()
    type(channel_t) :: channel
    integer :: again
    logical :: right
    call ring(channel)
    right = .true.
    do again = 1, 200
      call fill_ring(channel, again)
      call start_exchange(channel)
      call finish_exchange(channel)
      right = ring_is_right(channel, again) .and. right
    end do
    call check_true(right, "channels, again and again")
    call close_channel(channel)
    call ring(channel)
    call fill_ring(channel, 3)
    call start_exchange(channel)
    call finish_exchange(channel)
    call check_true(ring_is_right(channel, 3), "a channel that is opened again")
    call close_channel(channel)
    call check_true(.not. associated(channel%out) .and. .not. allocated(channel%to), "a closed channel has nothing")
  end subroutine test_channels

  !> Two at a time, that which began first ends last
  subroutine test_two_channels()
    type(channel_t) :: one, other
    integer :: again
    logical :: right
    call ring(one)
    call ring(other)
    right = .true.
    do again = 1, 50
      call fill_ring(one, again)
      call fill_ring(other, again + 1000)
      call start_exchange(one)
      call start_exchange(other)
      call finish_exchange(other)
      call finish_exchange(one)
      right = ring_is_right(one, again) .and. right
      right = ring_is_right(other, again + 1000) .and. right
    end do
    call check_true(right, "two channels under way")
    call close_channel(one)
    call close_channel(other)
  end subroutine test_two_channels

  !> The first and the last rank talk, all others have no message at all
  subroutine test_quiet_channel()
    type(channel_t) :: channel
    integer :: other, n, k
    other = ranks - 1 - this_rank
    n = merge(1, 0, this_rank == 0 .or. other == 0)
    channel%to = [(other, k=1, n)]
    channel%from = channel%to
    channel%to_first = [1_i8, (101_i8, k=1, n)]
    channel%from_first = channel%to_first
    call open_channel(channel)
    call finish_exchange(channel) ! nothing is under way
    channel%to_words = 100
    channel%out = value(this_rank, 0, 0)
    call start_exchange(channel)
    call finish_exchange(channel)
    call check_true(all(channel%in == value(other, 0, 0)) .and. size(channel%in) == 100*n, "ranks without messages")
    call close_channel(channel)
  end subroutine test_quiet_channel

  !> Sizes agree on both sides: the messages from the rank before are as large as those to the next
  subroutine ring(channel)
    type(channel_t), intent(out) :: channel
    integer :: next, before
    next = modulo(this_rank + 1, ranks)
    before = modulo(this_rank - 1, ranks)
    channel%to = [next, before, next]
    channel%from = [before, next, before]
    channel%to_first = [1_i8, 51_i8, 251_i8, 258_i8]
    channel%from_first = channel%to_first
    call open_channel(channel)
  end subroutine ring

  !> Words of message `k` of the rank in round `again`
  pure integer(i8) function message_words(rank, k, again)
    integer, intent(in) :: rank, k, again
    integer, parameter :: rooms(3) = [50, 200, 7]
    message_words = modulo(7*rank + 11*k + 13*again, rooms(k) + 1)
  end function message_words

  subroutine fill_ring(channel, again)
    type(channel_t), intent(inout) :: channel
    integer, intent(in) :: again
    integer :: k, i
    channel%to_words = [(message_words(this_rank, k, again), k=1, 3)]
    channel%out = -5
    channel%in = -7
    do k = 1, 3
      do i = 1, int(channel%to_words(k))
        channel%out(channel%to_first(k) + i - 1) = value(this_rank, k, i + again)
      end do
    end do
  end subroutine fill_ring

  logical function ring_is_right(channel, again) result(right)
    type(channel_t), intent(in) :: channel
    integer, intent(in) :: again
    integer :: k, i
    right = .true.
    do k = 1, 3
      right = right .and. channel%from_words(k) == message_words(channel%from(k), k, again)
      do i = 1, int(channel%from_words(k))
        right = right .and. channel%in(channel%from_first(k) + i - 1) == value(channel%from(k), k, i + again)
      end do
      right = right .and. all(channel%in(channel%from_first(k) + channel%from_words(k):channel%from_first(k + 1) - 1) == -7)
    end do
  end function ring_is_right

  !> What has been sent is counted; alone nothing is sent
  subroutine test_books()
    type(channel_t) :: channel
    integer(i8) :: calls(3), words(3), messages(3), to_count(0:ranks - 1), from_count(0:ranks - 1)
    integer(i8), allocatable :: from(:)
    integer :: k
    calls = traffic%calls
    words = traffic%words
    messages = traffic%messages
    call ring(channel)
    call fill_ring(channel, 1)
    call start_exchange(channel)
    call finish_exchange(channel)
    call close_channel(channel)
    to_count = 2
    call exchange_words(to_count, [(1_i8, k=1, 2*ranks)], from_count, from)
    call sum_words(to_count)
    call check_true(all(traffic%seconds >= 0), "nobody waits for less than nothing")
    if (backend == "serial") then
      call check_true(all(traffic%calls == 0), "one process alone sends nothing")
      return
    end if
    call check_true(all(traffic%calls - calls == 1), "calls are counted")
    call check(int(traffic(of_pads)%messages - messages(of_pads)), 3, "messages of channels")
    call check(int(traffic(of_pads)%words - words(of_pads)), int(sum([(message_words(this_rank, k, 1), k=1, 3)])), &
                       "words in channels")
    call check(int(traffic(of_lists)%messages - messages(of_lists)), ranks - 1, "messages of lists")
    call check(int(traffic(of_lists)%words - words(of_lists)), 2*(ranks - 1), "words in lists")
    call check(int(traffic(of_all)%words - words(of_all)), ranks, "words in sums")
  end subroutine test_books

  !> A word that tells where it comes from
  pure elemental integer(i8) function value(rank, other, k)
    integer, intent(in) :: rank, other, k
    value = (rank + 1)*1000000000000_i8 + (other + 1)*1000000000_i8 + k - 2_i8**55
  end function value

  pure logical function all_equal(a, b)
    integer(i8), intent(in) :: a(:), b(:)
    all_equal = size(a) == size(b)
    if (all_equal) all_equal = all(a == b)
  end function all_equal

end program test_ranks
