!> State on its way into a checkpoint or out of it, as 64-bit words.
!>
!> The owner of a state names each part once, with `carry`: the same list packs and unpacks, so that the two cannot differ.
!> A parcel that holds less than is asked for, or another length of a list, is told by `sound`; values are then left alone.
module gimp_parcel
  use gimp_common_kinds, only: sp, dp, i8
  implicit none(type, external)
  private
  public :: parcel_t, carry, carry_bits, pack_parcel, unpack_parcel, is_used_up

  !> Words, and how many of them were put in or taken out so far
  type :: parcel_t
    logical :: reading = .false.
    logical :: sound = .true. !! false: another program packed it
    integer(i8) :: n = 0
    integer(i8), allocatable :: words(:)
  end type parcel_t

  !> Put a value in, or take it out; a list comes out with the length it had
  interface carry
    module procedure carry_long, carry_integer, carry_real, carry_single, carry_logical, carry_text, carry_longs, carry_reals
  end interface carry

contains

  !> An empty parcel to be filled
  pure subroutine pack_parcel(parcel)
    type(parcel_t), intent(out) :: parcel
    allocate (parcel%words(64), source=0_i8)
  end subroutine pack_parcel

  !> A parcel to take things out of
  pure subroutine unpack_parcel(parcel, words)
    type(parcel_t), intent(out) :: parcel
    integer(i8), intent(in) :: words(:)
    parcel%words = words
    parcel%reading = .true.
  end subroutine unpack_parcel

  !> Whether all of it was taken out, and nothing was missing
  pure logical function is_used_up(parcel)
    type(parcel_t), intent(in) :: parcel
    is_used_up = parcel%sound .and. parcel%n == size(parcel%words, kind=i8)
  end function is_used_up

  pure subroutine carry_long(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    integer(i8), intent(inout) :: value
    integer(i8) :: one(1)
    one = value
    call carry_bits(parcel, one)
    value = one(1)
  end subroutine carry_long

  pure subroutine carry_integer(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    integer, intent(inout) :: value
    integer(i8) :: one(1)
    one = value
    call carry_bits(parcel, one)
    value = int(one(1))
  end subroutine carry_integer

  pure subroutine carry_real(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    real(dp), intent(inout) :: value
    integer(i8) :: one(1)
    one = transfer(value, one)
    call carry_bits(parcel, one)
    value = transfer(one, value)
  end subroutine carry_real

  pure subroutine carry_single(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    real(sp), intent(inout) :: value
    real(dp) :: same
    same = real(value, dp)
    call carry_real(parcel, same)
    value = real(same, sp)
  end subroutine carry_single

  pure subroutine carry_logical(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    logical, intent(inout) :: value
    integer(i8) :: one(1)
    one = merge(1_i8, 0_i8, value)
    call carry_bits(parcel, one)
    value = one(1) /= 0
  end subroutine carry_logical

  pure subroutine carry_text(parcel, value)
    type(parcel_t), intent(inout) :: parcel
    character(len=:), allocatable, intent(inout) :: value
    integer(i8), allocatable :: words(:)
    integer :: length
    length = 0
    if (allocated(value)) length = len(value)
    call carry_integer(parcel, length)
    allocate (words(0))
    if (.not. parcel%reading .and. length > 0) words = transfer(value//repeat(" ", 7), words) ! whole words only
    if (.not. parcel%reading) words = words(:(length + 7)/8)
    call carry_longs(parcel, words)
    if (.not. parcel%reading .or. .not. parcel%sound) return
    parcel%sound = length >= 0 .and. length <= 8*size(words)
    if (.not. parcel%sound) return
    value = transfer(words, repeat(" ", 8*size(words)))
    value = value(:length)
  end subroutine carry_text

  pure subroutine carry_longs(parcel, values)
    type(parcel_t), intent(inout) :: parcel
    integer(i8), allocatable, intent(inout) :: values(:)
    integer(i8) :: length
    length = 0
    if (allocated(values)) length = size(values, kind=i8)
    call carry_long(parcel, length)
    if (parcel%reading) then
      parcel%sound = parcel%sound .and. length >= 0 .and. length <= size(parcel%words, kind=i8) - parcel%n
      if (.not. parcel%sound) return
      values = parcel%words(parcel%n + 1:parcel%n + length)
      parcel%n = parcel%n + length
    else if (length > 0) then
      call carry_bits(parcel, values)
    end if
  end subroutine carry_longs

  pure subroutine carry_reals(parcel, values)
    type(parcel_t), intent(inout) :: parcel
    real(dp), allocatable, intent(inout) :: values(:)
    integer(i8), allocatable :: words(:)
    allocate (words(0))
    if (allocated(values)) words = transfer(values, words)
    call carry_longs(parcel, words)
    if (parcel%reading .and. parcel%sound) values = transfer(words, [0.0_dp], size(words))
  end subroutine carry_reals

  !> As many words as there are (the bits of a plain derived type, by `transfer`); all else goes through here
  pure subroutine carry_bits(parcel, words)
    type(parcel_t), intent(inout) :: parcel
    integer(i8), intent(inout) :: words(:)
    integer(i8), allocatable :: wider(:)
    integer(i8) :: n
    n = size(words, kind=i8)
    if (parcel%reading) then
      parcel%sound = parcel%sound .and. parcel%n + n <= size(parcel%words, kind=i8)
      if (.not. parcel%sound) return
      words = parcel%words(parcel%n + 1:parcel%n + n)
    else
      if (parcel%n + n > size(parcel%words, kind=i8)) then
        allocate (wider(2*(parcel%n + n)), source=0_i8)
        wider(:parcel%n) = parcel%words(:parcel%n)
        call move_alloc(wider, parcel%words)
      end if
      parcel%words(parcel%n + 1:parcel%n + n) = words
    end if
    parcel%n = parcel%n + n
  end subroutine carry_bits

end module gimp_parcel
