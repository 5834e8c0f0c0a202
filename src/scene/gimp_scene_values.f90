!> Single values of a scene: text to number and back, and ranges in words.
!>
!> Numbers are checked by hand before the runtime reads them, because list-directed reading accepts `nan`, `inf`, empty
!> values and digits left over, and traps on overflow in a build that checks floating point.
module gimp_scene_values
  use gimp_common_kinds, only: dp, i8
  use gimp_text, only: lower, text_of
  implicit none(type, external)
  private
  public :: parse_real, parse_integer, parse_logical, exact_text, quoted_text, in_range, range_words
  public :: count_values, nth_value

contains

  !> A finite real number; `status` 0 fine, 1 not a number at all, 2 not finite or out of what a double can hold
  pure subroutine parse_real(text, value, status)
    character(len=*), intent(in) :: text
    real(dp), intent(out) :: value !! 0 unless status is 0
    integer, intent(out) :: status
    character(len=:), allocatable :: number
    integer :: i, mark, digits, whole, power, first
    value = 0.0_dp
    status = 1
    number = lower(trim(text))
    i = 1
    if (verify(number, "+-abcdefghijklmnopqrstuvwxyz()0123456789_*#") == 0 .and. len(number) >= 3) then
      if (scan(number(1:1), "+-") == 1) i = 2
      if (index(number(i:), "nan") == 1 .or. index(number(i:), "inf") == 1) status = 2
      if (status == 2) return
    end if
    mark = scan(number, "ed")
    if (mark == 0) mark = len(number) + 1
    power = 0
    if (mark <= len(number)) then
      call parse_integer(number(mark + 1:), power, status)
      if (status == 1) return
      if (status == 2) power = merge(-9999, 9999, number(mark + 1:mark + 1) == "-")
      number(mark:mark) = "e"
    end if
    status = 1
    first = 1
    if (mark > 1) then
      if (scan(number(1:1), "+-") == 1) first = 2
    end if
    digits = 0
    do i = first, mark - 1
      if (number(i:i) >= "0" .and. number(i:i) <= "9") digits = digits + 1
    end do
    if (digits == 0 .or. mark - first - digits > 1) return
    whole = index(number(first:mark - 1), ".")
    if (mark - first - digits == 1 .and. whole == 0) return
    ! The position of the leading digit tells the size before the runtime computes it
    i = scan(number(first:mark - 1), "123456789")
    status = 0
    if (i == 0) return ! zero, whatever the exponent
    if (whole == 0) whole = mark - first + 1
    power = power + whole - i - merge(1, 0, i < whole)
    if (power < -330) return ! below the smallest denormal number
    status = 2
    if (power > 307) return ! close to the largest double or above it: no quantity of a scene
    read (number, *, iostat=status) value
    if (status /= 0) status = 1
  end subroutine parse_real

  !> A whole number; `status` 0 fine, 1 not a whole number, 2 too large
  pure subroutine parse_integer(text, value, status)
    character(len=*), intent(in) :: text
    integer, intent(out) :: value !! 0 unless status is 0
    integer, intent(out) :: status
    integer(i8) :: sum
    integer :: i, first
    value = 0
    status = 1
    first = 1
    if (len_trim(text) == 0) return
    if (scan(text(1:1), "+-") == 1) first = 2
    if (len_trim(text) < first) return
    if (verify(text(first:len_trim(text)), "0123456789") /= 0) return
    status = 2
    sum = 0
    do i = first, len_trim(text)
      sum = 10*sum + iachar(text(i:i)) - iachar("0")
      if (sum > huge(value)) return
    end do
    status = 0
    value = int(sum)
    if (text(1:1) == "-") value = -value
  end subroutine parse_integer

  pure subroutine parse_logical(text, value, status)
    character(len=*), intent(in) :: text
    logical, intent(out) :: value
    integer, intent(out) :: status !! 0 fine, 1 not a logical
    value = .false.
    status = 0
    select case (lower(trim(text)))
    case (".true.", "true", ".t.", "t")
      value = .true.
    case (".false.", "false", ".f.", "f")
      value = .false.
    case default
      status = 1
    end select
  end subroutine parse_logical

  !> The shortest text that reads back as exactly this number
  pure function exact_text(value) result(text)
    real(dp), intent(in) :: value
    character(len=:), allocatable :: text
    real(dp) :: again
    character(len=24) :: buffer
    integer :: digits, status
    do digits = 1, 17
      text = text_of(value, digits)
      call parse_real(text, again, status)
      if (status == 0 .and. again == value) exit
    end do
    if (status /= 0 .or. again /= value) then
      write (buffer, "(es24.16e3)") value ! 17 digits are always enough
      text = trim(adjustl(buffer))
    end if
    if (scan(text, ".eE") == 0) text = text//".0"
  end function exact_text

  !> Text between quotes, as a namelist wants it
  pure function quoted_text(text) result(quoted)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: quoted
    integer :: i
    quoted = '"'
    do i = 1, len(text)
      quoted = quoted//text(i:i)
      if (text(i:i) == '"') quoted = quoted//'"'
    end do
    quoted = quoted//'"'
  end function quoted_text

  !> Whether a value lies in a range such as "(0,1]"; an empty range holds every value
  pure logical function in_range(value, range)
    real(dp), intent(in) :: value
    character(len=*), intent(in) :: range
    character(len=16) :: ends(2)
    real(dp) :: limit
    integer :: status
    in_range = .true.
    if (len_trim(range) == 0) return
    call split_range(range, ends)
    if (ends(1) /= "") then
      call parse_real(ends(1), limit, status)
      in_range = value > limit .or. (value == limit .and. range(1:1) == "[")
    end if
    if (ends(2) /= "") then
      call parse_real(ends(2), limit, status)
      in_range = in_range .and. (value < limit .or. (value == limit .and. index(range, "]") > 0))
    end if
  end function in_range

  !> A range in words: "above 0", "between 1 and 16"; empty for an empty range
  pure function range_words(range) result(text)
    character(len=*), intent(in) :: range
    character(len=:), allocatable :: text
    character(len=16) :: ends(2)
    logical :: low_in, high_in
    text = ""
    if (len_trim(range) == 0) return
    call split_range(range, ends)
    low_in = range(1:1) == "["
    high_in = index(range, "]") > 0
    if (ends(1) /= "" .and. ends(2) /= "" .and. (low_in .eqv. high_in)) then
      text = "between "//trim(ends(1))//" and "//trim(ends(2))
      if (.not. low_in) text = text//" (both excluded)"
      return
    end if
    if (ends(1) /= "") then
      text = "above "//trim(ends(1))
      if (low_in) text = "at least "//trim(ends(1))
    end if
    if (ends(2) /= "") then
      if (text /= "") text = text//" and "
      if (high_in) text = text//"at most "//trim(ends(2))
      if (.not. high_in) text = text//"below "//trim(ends(2))
    end if
  end function range_words

  pure subroutine split_range(range, ends)
    character(len=*), intent(in) :: range
    character(len=16), intent(out) :: ends(2)
    integer :: comma
    comma = index(range, ",")
    ends(1) = range(2:comma - 1)
    ends(2) = range(comma + 1:len_trim(range) - 1)
  end subroutine split_range

  !> How many values a default of the key table holds: "0,1,0" holds three
  pure integer function count_values(list)
    character(len=*), intent(in) :: list
    integer :: i
    count_values = 0
    if (len_trim(list) == 0) return
    count_values = 1
    do i = 1, len_trim(list)
      if (list(i:i) == ",") count_values = count_values + 1
    end do
  end function count_values

  !> The n-th value of such a list
  pure function nth_value(list, n) result(value)
    character(len=*), intent(in) :: list
    integer, intent(in) :: n
    character(len=:), allocatable :: value
    integer :: i, k, first
    value = ""
    k = 1
    first = 1
    do i = 1, len_trim(list) + 1
      if (i <= len_trim(list)) then
        if (list(i:i) /= ",") cycle
      end if
      if (k == n) value = trim(adjustl(list(first:i - 1)))
      k = k + 1
      first = i + 1
    end do
  end function nth_value

end module gimp_scene_values
