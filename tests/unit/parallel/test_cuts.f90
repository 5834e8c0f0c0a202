!> Cuts of block keys: ranges without a gap, work equal to one block, the same cuts whoever knows of which blocks
program test_cuts
  use gimp_common_kinds, only: i8
  use gimp_text, only: text_of
  use gimp_ranks, only: this_rank, ranks, backend, start_ranks, end_ranks, sum_words
  use gimp_over_ranks, only: any_rank
  use gimp_cuts, only: find_cuts, rank_of_key, is_mine, work_of_ranks
  use gimp_check, only: begin_suite, suite_failed, check_true
  implicit none(type, external)

  integer(i8), parameter :: last_key = 2_i8**60 - 1 !! three axes of 20 bits
  integer(i8) :: seed = 4711
  integer :: n

  call start_ranks()
  call begin_suite("cuts, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  do n = 1, 40
    call test_random(n)
  end do
  call test_one_heavy()
  call test_nothing()
  call test_large()
  call end_ranks(merge(1, 0, any_rank(suite_failed())))

contains

  !> Whole numbers from 0 to n - 1, the same on all ranks
  integer(i8) function random(n)
    integer(i8), intent(in) :: n
    seed = modulo(16807*seed, 2147483647_i8)
    random = modulo(seed*seed, n)
  end function random

  !> So many keys, dense at one end or spread, with work that differs a little or a lot
  subroutine test_random(n)
    integer, intent(in) :: n
    integer(i8) :: keys(n), work(n)
    integer :: k
    do k = 1, n
      keys(k) = merge(int(k, i8), last_key/n*k - random(last_key/n), modulo(n, 3) == 0)
      work(k) = 1 + random(merge(3_i8, 1000_i8, modulo(n, 2) == 0))
    end do
    call check_cuts(keys, work, text_of(n)//" blocks")
  end subroutine test_random

  !> A block with more work than all others
  subroutine test_one_heavy()
    integer(i8) :: keys(30), work(30)
    integer :: k
    do k = 1, 30, 7
      keys = [(3*int(n, i8), n=1, 30)]
      work = 1
      work(k) = 1000
      call check_cuts(keys, work, "a heavy block, "//text_of(k))
    end do
  end subroutine test_one_heavy

  subroutine test_nothing()
    integer(i8) :: none(0)
    call check_cuts(none, none, "no blocks")
  end subroutine test_nothing

  !> Work of 4e9 particles in each of 1e8 blocks
  subroutine test_large()
    integer(i8) :: keys(64), work(64)
    keys = [(last_key - 64 + n, n=1, 64)]
    work = 4_i8*10_i8**15
    call check_cuts(keys, work, "much work")
  end subroutine test_large

  !> All that is promised of cuts, with the keys dealt out to ranks in several ways
  subroutine check_cuts(keys, work, which)
    integer(i8), intent(in) :: keys(:), work(:)
    character(len=*), intent(in) :: which
    integer(i8) :: cut(0:ranks), other(0:ranks), owned(0:ranks - 1), expected(0:ranks - 1), below
    integer(i8), allocatable :: share(:)
    integer :: owners(size(keys)), k, r, deal, n
    logical :: mine(size(keys))
    n = size(keys)
    mine = [(n*this_rank/ranks < k .and. k <= n*(this_rank + 1)/ranks, k=1, n)]
    call find_cuts(pack(keys, mine), pack(work, mine), cut)
    call check_true(cut(0) == 0 .and. cut(ranks) > last_key .and. all(cut(1:) >= cut(:ranks - 1)), "ranges without a gap, "//which)
    do deal = 1, 3
      select case (deal)
      case (1) ! one after the other
        mine = [(modulo(k, ranks) == this_rank, k=1, size(keys))]
        call find_cuts(pack(keys, mine), pack(work, mine), other)
      case (2) ! the last has all
        mine = this_rank == ranks - 1
        call find_cuts(pack(keys, mine), pack(work, mine), other)
      case (3) ! each has a part of the work of every block
        share = work/ranks
        if (this_rank == 0) share = work - (ranks - 1)*(work/ranks)
        call find_cuts(keys, share, other)
      end select
      call check_true(all(other == cut), "the same cuts, dealt in way "//text_of(deal)//", "//which)
    end do
    expected = 0
    do k = 1, size(keys)
      owners(k) = rank_of_key(cut, keys(k))
      call check_true(owners(k) == count(cut(1:ranks - 1) <= keys(k)), "the owner of a key, "//which)
      call check_true(is_mine(cut, keys(k)) .eqv. owners(k) == this_rank, "and what it says itself, "//which)
      expected(owners(k)) = expected(owners(k)) + work(k)
    end do
    mine = owners == this_rank
    call work_of_ranks(pack(keys, mine), pack(work, mine), cut, owned)
    call check_true(all(owned == expected), "work of each rank, "//which)
    if (size(keys) == 0) return
    do r = 1, ranks - 1
      below = sum(work, mask=keys < cut(r))
      call check_true(abs(ranks*below - r*sum(work)) <= ranks*maxval(work), "equal to a block at cut "//text_of(r)//", "//which)
    end do
    ! a heavy block is alone at most with what is before and after it in its rank's share
    call check_true(maxval(owned) <= sum(work)/ranks + maxval(work) + 1, "nobody has more than a block above the mean, "//which)
    call check_true(dealt_out(mine), "every block has one owner, "//which)
  end subroutine check_cuts

  !> Whether each entry is true on exactly one rank
  logical function dealt_out(mine)
    logical, intent(in) :: mine(:)
    integer(i8) :: words(size(mine))
    words = merge(1_i8, 0_i8, mine)
    if (ranks > 1) call sum_words(words)
    dealt_out = all(words == 1)
  end function dealt_out

end program test_cuts
