!> Shares follow one another, leave nothing out and differ by one item at most
program test_shares
  use gimp_common_kinds, only: i8
  use gimp_text, only: text_of
  use gimp_shares, only: share_t, items_of_share
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  integer(i8) :: n
  integer :: shares

  call begin_suite("shares")
  do shares = 1, 9
    do n = 0, 30
      call deal(n, shares)
    end do
  end do
  call deal(huge(1_i8), 1000)
  call check_true(all(items_of_share(share_t(), 12_i8) == [1_i8, 12_i8]), "a share that nobody described is all")
  call end_suite()

contains

  subroutine deal(n, shares)
    integer(i8), intent(in) :: n
    integer, intent(in) :: shares
    integer(i8) :: items(2), last, least, most
    integer :: k
    logical :: in_row
    in_row = .true.
    last = 0
    least = huge(1_i8)
    most = 0
    do k = 0, shares - 1
      items = items_of_share(share_t(k, shares), n)
      in_row = in_row .and. items(1) == last + 1
      last = items(2)
      least = min(least, items(2) - items(1) + 1)
      most = max(most, items(2) - items(1) + 1)
    end do
    call check_true(in_row .and. last == n .and. least >= 0 .and. most - least <= 1, text_of(n)//" items, "//text_of(shares)//" shares")
  end subroutine deal

end program test_shares
