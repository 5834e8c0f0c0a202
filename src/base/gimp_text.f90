!> Small text helpers: numbers in words, lower case, lists of words
module gimp_text
  use gimp_common_kinds, only: sp, dp, i8
  implicit none(type, external)
  private
  public :: text_of, lower, word_in, count_words, nth_word, with_thousands, short_number

  !> A number as text without blanks around it
  interface text_of
    module procedure text_of_integer, text_of_long, text_of_real, text_of_single, text_of_logical
  end interface text_of

contains

  pure function text_of_integer(value) result(text)
    integer, intent(in) :: value
    character(len=:), allocatable :: text
    character(len=16) :: buffer
    write (buffer, "(i0)") value
    text = trim(buffer)
  end function text_of_integer

  pure function text_of_long(value) result(text)
    integer(i8), intent(in) :: value
    character(len=:), allocatable :: text
    character(len=24) :: buffer
    write (buffer, "(i0)") value
    text = trim(buffer)
  end function text_of_long

  !> Up to `digits` significant digits (6 if absent), no trailing zeros, a leading zero before the point
  pure function text_of_real(value, digits) result(text)
    real(dp), intent(in) :: value
    integer, intent(in), optional :: digits
    character(len=:), allocatable :: text
    character(len=40) :: buffer, form
    integer :: n, e, mark
    n = 6
    if (present(digits)) n = digits
    if (value == 0.0_dp) then
      text = "0"
      return
    end if
    if (.not. abs(value) <= huge(value)) then
      text = "NaN"
      if (value > 0.0_dp) text = "Infinity"
      if (value < 0.0_dp) text = "-Infinity"
      return
    end if
    e = floor(log10(abs(value)))
    if (e >= -4 .and. e < max(n, 7)) then
      write (form, "(a,i0,a)") "(f40.", max(0, n - 1 - e), ")"
      write (buffer, form) value
      text = trim(adjustl(buffer))
      if (index(text, ".") > 0) then
        do while (text(len(text):) == "0")
          text = text(:len(text) - 1)
        end do
        if (text(len(text):) == ".") text = text(:len(text) - 1)
      end if
      if (text(1:1) == ".") text = "0"//text
      if (len(text) > 1) then
        if (text(1:2) == "-.") text = "-0"//text(2:)
      end if
    else
      write (form, "(a,i0,a)") "(es40.", n - 1, "e3)"
      write (buffer, form) value
      text = trim(adjustl(buffer))
      mark = scan(text, "E")
      e = mark - 1
      if (index(text(:e), ".") > 0) then
        do while (text(e:e) == "0")
          e = e - 1
        end do
        if (text(e:e) == ".") e = e - 1
      end if
      buffer = text(mark + 2:) ! three digits of the exponent
      do while (len_trim(buffer) > 2 .and. buffer(1:1) == "0")
        buffer = buffer(2:)
      end do
      if (text(mark + 1:mark + 1) == "-") buffer = "-"//buffer(:39)
      text = text(:e)//"e"//trim(buffer)
    end if
  end function text_of_real

  !> The same for a number in single precision, which has seven digits to show at most
  pure function text_of_single(value, digits) result(text)
    real(sp), intent(in) :: value
    integer, intent(in), optional :: digits
    character(len=:), allocatable :: text
    text = text_of_real(real(value, dp), digits)
  end function text_of_single

  pure function text_of_logical(value) result(text)
    logical, intent(in) :: value
    character(len=:), allocatable :: text
    text = ".false."
    if (value) text = ".true."
  end function text_of_logical

  !> 1234567 as 1,234,567
  pure function with_thousands(value) result(text)
    integer(i8), intent(in) :: value
    character(len=:), allocatable :: text
    integer :: k
    text = text_of(value)
    k = len(text) - 3
    do while (k >= 1)
      if (text(k:k) == "-") exit
      text = text(:k)//","//text(k + 1:)
      k = k - 3
    end do
  end function with_thousands

  !> A number with a suffix: 1.23 k, 4.5 M, 6.7 G
  pure function short_number(value) result(text)
    real(dp), intent(in) :: value
    character(len=:), allocatable :: text
    if (abs(value) >= 1.0e9_dp) then
      text = text_of(value*1.0e-9_dp, 3)//" G"
    else if (abs(value) >= 1.0e6_dp) then
      text = text_of(value*1.0e-6_dp, 3)//" M"
    else if (abs(value) >= 1.0e4_dp) then
      text = text_of(value*1.0e-3_dp, 3)//" k"
    else
      text = text_of(value, 4)//" "
    end if
  end function short_number

  pure function lower(text) result(low)
    character(len=*), intent(in) :: text
    character(len=len(text)) :: low
    integer :: i
    low = text
    do i = 1, len(text)
      if (text(i:i) >= "A" .and. text(i:i) <= "Z") low(i:i) = achar(iachar(text(i:i)) + 32)
    end do
  end function lower

  !> Position of `word` in a list of words with blanks between them; 0 if it is not there
  pure integer function word_in(word, list) result(position)
    character(len=*), intent(in) :: word, list
    integer :: k
    position = 0
    do k = 1, count_words(list)
      if (nth_word(list, k) == word) position = k
    end do
  end function word_in

  pure integer function count_words(list) result(n)
    character(len=*), intent(in) :: list
    integer :: i
    n = 0
    do i = 1, len_trim(list)
      if (list(i:i) == " ") cycle
      if (i == 1) then
        n = n + 1
      else if (list(i - 1:i - 1) == " ") then
        n = n + 1
      end if
    end do
  end function count_words

  pure function nth_word(list, n) result(word)
    character(len=*), intent(in) :: list
    integer, intent(in) :: n
    character(len=:), allocatable :: word
    integer :: i, k, first
    word = ""
    k = 0
    first = 1
    do i = 1, len_trim(list)
      if (list(i:i) == " ") cycle
      if (i == 1) then
        k = k + 1; first = i
      else if (list(i - 1:i - 1) == " ") then
        k = k + 1; first = i
      end if
      if (k /= n) cycle
      if (i == len_trim(list)) then
        word = list(first:i)
        return
      else if (list(i + 1:i + 1) == " ") then
        word = list(first:i)
        return
      end if
    end do
  end function nth_word

end module gimp_text
