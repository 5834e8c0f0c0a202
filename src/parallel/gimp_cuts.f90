!> Which rank owns a block: ranks own consecutive ranges of block keys, cut so that each has about the same counted work.
!>
!> The cuts depend on what work there is at which key, not on who knows of it, so that a state is cut in one way however it lies now.
module gimp_cuts
  use gimp_common_kinds, only: i8
  use gimp_ranks, only: this_rank, ranks, sum_words, largest_words
  implicit none(type, external)
  private
  public :: find_cuts, rank_of_key, is_mine, work_of_ranks

  integer, parameter :: key_bits = 62

contains

  !> Cut so that ranks have equal work: rank r owns the keys cut(r) <= key < cut(r + 1). Collective
  subroutine find_cuts(keys, work, cut)
    integer(i8), intent(in) :: keys(:) !! ascending, of the blocks that this rank knows of; others may know of the same
    integer(i8), intent(in) :: work(:) !! of each
    integer(i8), intent(out) :: cut(0:) !! (0:ranks)
    integer(i8) :: before(0:size(keys)), all_work(1), aim(ranks - 1), low(ranks - 1), high(ranks - 1), mid(ranks - 1), &
      below(ranks - 1), last(ranks - 1), at_last(ranks - 1)
    integer :: k
    cut = 0
    cut(ranks) = huge(cut)
    if (ranks == 1) return
    before(0) = 0
    do k = 1, size(keys)
      before(k) = before(k - 1) + work(k)
    end do
    all_work = before(size(keys))
    call sum_words(all_work)
    do k = 1, ranks - 1
      aim(k) = all_work(1)/ranks*k + modulo(all_work(1), int(ranks, i8))*k/ranks
    end do
    low = 0
    high = shiftl(1_i8, key_bits)
    do while (any(low < high)) ! the least key below which there is as much work as aimed at
      mid = low + (high - low)/2
      below = [(before(keys_below(keys, mid(k))), k=1, ranks - 1)]
      call sum_words(below)
      where (below >= aim)
        high = mid
      elsewhere
        low = min(mid + 1, high)
      end where
    end do
    ! or the one before it, where that is nearer to the aim
    below = [(before(keys_below(keys, low(k))), k=1, ranks - 1)]
    last = -1
    do k = 1, ranks - 1
      if (keys_below(keys, low(k)) > 0) last(k) = keys(keys_below(keys, low(k)))
    end do
    call largest_words(last)
    at_last = [(before(keys_below(keys, last(k) + 1)) - before(keys_below(keys, last(k))), k=1, ranks - 1)]
    call sum_words(below)
    call sum_words(at_last)
    where (below - aim > aim - (below - at_last) .and. last >= 0) low = last
    cut(1:ranks - 1) = low
    do k = 2, ranks - 1 ! rounding to the nearer block keeps the order
      cut(k) = max(cut(k), cut(k - 1))
    end do
  end subroutine find_cuts

  !> How many keys of an ascending list are less than one
  pure integer function keys_below(keys, key) result(n)
    integer(i8), intent(in) :: keys(:), key
    integer :: low, high, mid
    low = 0
    high = size(keys)
    do while (low < high)
      mid = (low + high + 1)/2
      if (keys(mid) < key) then
        low = mid
      else
        high = mid - 1
      end if
    end do
    n = low
  end function keys_below

  !> The rank that owns a key
  pure integer function rank_of_key(cut, key) result(rank)
    integer(i8), intent(in) :: cut(0:), key
    integer :: high, mid
    rank = 0
    high = ubound(cut, 1) - 1
    do while (rank < high) ! the last that begins at the key or before: those that begin at the same one are empty
      mid = (rank + high + 1)/2
      if (cut(mid) <= key) then
        rank = mid
      else
        high = mid - 1
      end if
    end do
  end function rank_of_key

  !> Whether this rank owns a key
  pure logical function is_mine(cut, key)
    integer(i8), intent(in) :: cut(0:), key
    is_mine = key >= cut(this_rank) .and. key < cut(this_rank + 1)
  end function is_mine

  !> Work that each rank has with these cuts. Collective
  subroutine work_of_ranks(keys, work, cut, total)
    integer(i8), intent(in) :: keys(:), work(:), cut(0:)
    integer(i8), intent(out) :: total(0:) !! (0:ranks - 1)
    integer :: k, r
    total = 0
    do k = 1, size(keys)
      r = rank_of_key(cut, keys(k))
      total(r) = total(r) + work(k)
    end do
    call sum_words(total)
  end subroutine work_of_ranks

end module gimp_cuts
