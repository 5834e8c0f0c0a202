!> What is packed comes out again, and a parcel that holds something else is told
program test_parcel
  use gimp_common_kinds, only: dp, i8
  use gimp_parcel, only: parcel_t, carry, carry_bits, pack_parcel, unpack_parcel, is_used_up
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  !> One of each kind
  type :: things_t
    integer :: number = 0
    integer(i8) :: long = 0
    real(dp) :: value = 0.0_dp
    logical :: claim = .false.
    character(len=:), allocatable :: text, nothing
    integer(i8), allocatable :: longs(:)
    real(dp), allocatable :: values(:)
    integer(i8) :: bits(2) = 0
  end type things_t

  call begin_suite("parcel")
  call all_comes_out()
  call other_content_is_told()
  call end_suite()

contains

  subroutine carry_things(things, parcel)
    type(things_t), intent(inout) :: things
    type(parcel_t), intent(inout) :: parcel
    call carry(parcel, things%number)
    call carry(parcel, things%long)
    call carry(parcel, things%value)
    call carry(parcel, things%claim)
    call carry(parcel, things%text)
    call carry(parcel, things%nothing)
    call carry(parcel, things%longs)
    call carry(parcel, things%values)
    call carry_bits(parcel, things%bits)
  end subroutine carry_things

  subroutine fill(parcel)
    type(parcel_t), intent(out) :: parcel
    type(things_t) :: things
    integer :: k
    things%number = -7
    things%long = 2_i8**40 + 1
    things%value = 0.1_dp
    things%claim = .true.
    things%text = "nine char"
    things%longs = [(int(k, i8)**3, k=1, 500)]
    things%values = [(1.0_dp/k, k=1, 3)]
    things%bits = [3_i8, -4_i8]
    call pack_parcel(parcel)
    call carry_things(things, parcel)
  end subroutine fill

  subroutine all_comes_out()
    type(parcel_t) :: packed, parcel
    type(things_t) :: things
    integer :: k
    call fill(packed)
    call unpack_parcel(parcel, packed%words(:packed%n))
    call carry_things(things, parcel)
    call check_true(is_used_up(parcel), "all was taken out, nothing was missing")
    call check_true(things%number == -7 .and. things%long == 2_i8**40 + 1 .and. things%claim, "whole numbers and claims")
    call check(things%value, 0.1_dp, 0.0_dp, "a number, to the last bit")
    call check(things%text, "nine char", "a text that is no multiple of eight long")
    call check(things%nothing, "", "an empty text")
    call check_true(all(things%longs == [(int(k, i8)**3, k=1, 500)]), "a list longer than a new parcel")
    call check(things%values, [(1.0_dp/k, k=1, 3)], 0.0_dp, "a list of numbers")
    call check_true(all(things%bits == [3_i8, -4_i8]), "bits")
  end subroutine all_comes_out

  subroutine other_content_is_told()
    type(parcel_t) :: packed, parcel
    type(things_t) :: things
    integer(i8) :: n
    call fill(packed)
    do n = 0, packed%n - 1
      things = things_t()
      call unpack_parcel(parcel, packed%words(:n))
      call carry_things(things, parcel)
      if (is_used_up(parcel)) exit
    end do
    call check_true(n == packed%n, "a parcel cut short anywhere is told")
    call unpack_parcel(parcel, [packed%words(:packed%n), 0_i8])
    call carry_things(things, parcel)
    call check_true(parcel%sound .and. .not. is_used_up(parcel), "a parcel that holds more is told")
    call unpack_parcel(parcel, [-1_i8, 5_i8])
    call carry(parcel, things%text)
    call check_true(.not. parcel%sound, "a length that cannot be is told")
  end subroutine other_content_is_told

end program test_parcel
