!> Sums without an order: the same words for any permutation and any split of the terms, and right
program test_exact_sum
  use gimp_common_kinds, only: dp, i8
  use gimp_exact_sum, only: words_of_sum, wide_sum_t, add_exactly, pack_sum, merge_sums, value_of_sum
  use gimp_check, only: begin_suite, end_suite, check, check_true
  use, intrinsic :: iso_fortran_env, only: real128
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_positive_inf, ieee_negative_inf, ieee_is_nan
  implicit none(type, external)

  real(dp), parameter :: smallest = 4.9406564584124654e-324_dp !! above zero
  integer(i8) :: seed = 88172645463325252_i8

  call begin_suite("exact sum")
  call test_any_order()
  call test_value()
  call test_cancellation()
  call test_kept_bits()
  call test_ends_of_the_range()
  call test_not_numbers()
  call test_nothing()
  call test_many()
  call end_suite()

contains

  !> Permuted, and split into parts that are merged in any order
  subroutine test_any_order()
    real(dp) :: terms(2000)
    integer(i8) :: words(words_of_sum)
    integer :: kind, again
    logical :: ordered, merged
    do kind = 1, 4
      terms = some_terms(kind, 2000)
      words = words_of(terms)
      ordered = .true.
      merged = .true.
      do again = 1, 20
        call shuffle(terms)
        ordered = ordered .and. all(words_of(terms) == words)
        merged = all(words_of_parts(terms) == words) .and. merged
      end do
      call check_true(ordered, "any order gives the same words: "//name_of(kind))
      call check_true(merged, "parts merged in any order give the same words: "//name_of(kind))
    end do
  end subroutine test_any_order

  !> Against a sum in quadruple precision: the terms span few enough bits for that to be exact
  subroutine test_value()
    real(dp) :: terms(300)
    real(dp) :: expected
    integer :: kind, again
    logical :: close
    do kind = 1, 2
      close = .true.
      do again = 1, 50
        terms = some_terms(kind, 300)
        expected = real(sum(real(terms, real128)), dp)
        close = close .and. abs(value_of(terms) - expected) <= spacing(expected)
      end do
      call check_true(close, "within one unit in the last place: "//name_of(kind))
    end do
    terms = some_terms(3, 300) ! of any size, where the largest rules: 300 terms lose 2^-84 of it each
    call check(value_of(terms)/maxval(abs(terms)), real(sum(real(terms, real128)/maxval(abs(terms))), dp), 2*epsilon(1.0_dp), &
               "terms of any size")
  end subroutine test_value

  !> What is left when large terms cancel is exact
  subroutine test_cancellation()
    real(dp) :: terms(500)
    terms = some_terms(1, 500)
    call check(value_of([terms, -terms]), 0.0_dp, 0.0_dp, "a sum and its negative leave nothing")
    call check(value_of([1.0e16_dp, 1.0e-3_dp, -1.0e16_dp]), 1.0e-3_dp, 1.0e16_dp*2.0_dp**(-84), &
               "small terms survive")
    call check(value_of([terms, 1.0e-9_dp, -terms]), 1.0e-9_dp, 0.0_dp, "one small term survives among many")
    call check(value_of([-1.0_dp, -2.0_dp, 0.5_dp]), -2.5_dp, 0.0_dp, "a negative sum")
    call check(value_of([-1.0_dp, epsilon(1.0_dp)/2]), -1.0_dp + epsilon(1.0_dp)/2, 0.0_dp, "just above a negative power of two")
  end subroutine test_cancellation

  !> A term 2^-84 as large as the largest one counts, whatever their place in the bins, and one 2^-117 as large is gone
  subroutine test_kept_bits()
    integer :: e
    logical :: kept, gone
    kept = .true.
    gone = .true.
    do e = -1074 + 84, 1023
      kept = kept .and. same(value_of([scale(1.0_dp, e), scale(1.0_dp, e - 84), -scale(1.0_dp, e)]), scale(1.0_dp, e - 84))
      kept = kept .and. same(value_of([-scale(1.0_dp, e), -scale(1.0_dp, e - 84), scale(1.0_dp, e)]), -scale(1.0_dp, e - 84))
      if (e < -1074 + 117) cycle
      gone = gone .and. same(value_of([scale(1.0_dp, e - 117), scale(1.0_dp, e), -scale(1.0_dp, e)]), 0.0_dp)
    end do
    call check_true(kept, "84 bits from the leading one are kept")
    call check_true(gone, "what is too small is dropped in whatever order it comes")
  end subroutine test_kept_bits

  !> The smallest and the largest numbers there are
  subroutine test_ends_of_the_range()
    real(dp) :: few(5)
    integer :: k
    call check_true(same(value_of([smallest]), smallest), "the smallest number")
    call check_true(same(value_of([(smallest, k=1, 1000)]), 1000*smallest), "a thousand of the smallest")
    call check_true(same(value_of([tiny(1.0_dp), -smallest]), tiny(1.0_dp) - smallest), "normal and not")
    call check_true(same(value_of([-smallest, 0.0_dp]), -smallest), "a negative one below the normal ones")
    call check_true(same(value_of([huge(1.0_dp)]), huge(1.0_dp)), "the largest number")
    call check_true(same(value_of([-huge(1.0_dp)]), -huge(1.0_dp)), "the most negative number")
    call check_true(same(value_of([huge(1.0_dp), huge(1.0_dp), -huge(1.0_dp)]), huge(1.0_dp)), "too large on the way only")
    few = [1.0e300_dp, 1.0e-300_dp, -1.0e300_dp, 3.0_dp, -1.0e299_dp]
    call check(value_of(few), -1.0e299_dp, 0.0_dp, "from 1e-300 to 1e300")
    call check(value_of(-few), 1.0e299_dp, 0.0_dp, "and its negative")
  end subroutine test_ends_of_the_range

  !> One of them spoils a sum, wherever it is, for good
  subroutine test_not_numbers()
    real(dp) :: bad(3), terms(4)
    integer :: k, at
    logical :: spoilt
    bad = [ieee_value(1.0_dp, ieee_quiet_nan), ieee_value(1.0_dp, ieee_positive_inf), ieee_value(1.0_dp, ieee_negative_inf)]
    spoilt = .true.
    do k = 1, 3
      do at = 1, 4
        terms = [1.0_dp, -1.0e300_dp, 0.0_dp, huge(1.0_dp)]
        terms(at) = bad(k)
        spoilt = all(words_of_parts(terms) == words_of(terms)) .and. spoilt
        spoilt = ieee_is_nan(value_of(terms)) .and. spoilt
      end do
    end do
    call check_true(spoilt, "what is no finite number makes the sum none")
  end subroutine test_not_numbers

  subroutine test_nothing()
    real(dp) :: none(0)
    integer(i8) :: words(words_of_sum)
    call check_true(same(value_of(none), 0.0_dp), "no term: zero")
    call check_true(same(value_of([0.0_dp, -0.0_dp]), 0.0_dp), "zeros: zero")
    words = words_of([2.5_dp])
    call merge_words(words, words_of(none))
    call check_true(same(value_of_sum(words), 2.5_dp), "nothing added to a sum")
    words = words_of(none)
    call merge_words(words, words_of([2.5_dp]))
    call check_true(same(value_of_sum(words), 2.5_dp), "a sum added to nothing")
  end subroutine test_nothing

  !> A million terms of full bins: nothing overflows
  subroutine test_many()
    type(wide_sum_t) :: total
    integer(i8) :: words(words_of_sum)
    integer :: k
    do k = 1, 1000000
      call add_exactly(total, -nearest(1.0_dp, -1.0_dp))
    end do
    call check(value_of_sum(pack_sum(total)), -1.0e6_dp*nearest(1.0_dp, -1.0_dp), 0.0_dp, "a million times the same")
    words = pack_sum(total)
    do k = 1, 10 ! 2^30 terms
      call merge_words(words, (words))
    end do
    call check(value_of_sum(words), -1.024e9_dp*nearest(1.0_dp, -1.0_dp), 0.0_dp, "a thousand million times the same")
  end subroutine test_many

  !> Terms of one kind: of like size, of sizes that 113 bits hold, of any size, below the normal ones
  function some_terms(kind, n) result(terms)
    integer, intent(in) :: kind, n
    real(dp) :: terms(n)
    integer :: k
    do k = 1, n
      terms(k) = 2*random() - 1
      if (kind == 2) terms(k) = scale(terms(k), int(40*random()) - 20)
      if (kind == 3) terms(k) = terms(k)*10.0_dp**(600*random() - 300)
      if (kind == 4) terms(k) = terms(k)*1.0e-308_dp
    end do
  end function some_terms

  function name_of(kind) result(name)
    integer, intent(in) :: kind
    character(len=:), allocatable :: name
    character(len=24), parameter :: names(4) = [character(len=24) :: "terms of like size", "of sizes up to 2^40", &
                                                "from 1e-300 to 1e300", "below the normal numbers"]
    name = trim(names(kind))
  end function name_of

  function words_of(terms) result(words)
    real(dp), intent(in) :: terms(:)
    integer(i8) :: words(words_of_sum)
    type(wide_sum_t) :: total
    integer :: k
    do k = 1, size(terms)
      call add_exactly(total, terms(k))
    end do
    words = pack_sum(total)
  end function words_of

  real(dp) function value_of(terms)
    real(dp), intent(in) :: terms(:)
    value_of = value_of_sum(words_of(terms))
  end function value_of

  !> The same from parts of random lengths, some of them empty, that are merged in a random order
  function words_of_parts(terms) result(words)
    real(dp), intent(in) :: terms(:)
    integer, parameter :: parts = 9
    integer(i8) :: words(words_of_sum)
    integer :: cut(0:parts), k
    real(dp) :: order(parts)
    cut(0) = 0
    do k = 1, parts
      cut(k) = cut(k - 1) + int((size(terms) - cut(k - 1) + 1)*random()*0.5_dp)
      order(k) = random()
    end do
    cut(parts) = size(terms)
    words = words_of(terms(:0))
    do while (any(order < 1))
      k = minloc(order, dim=1)
      order(k) = 1
      call merge_words(words, words_of(terms(cut(k - 1) + 1:cut(k))))
    end do
  end function words_of_parts

  !> words <- words + more
  subroutine merge_words(words, more)
    integer(i8), intent(inout) :: words(words_of_sum)
    integer(i8), intent(in) :: more(words_of_sum)
    integer(i8) :: sums(words_of_sum, 1)
    sums(:, 1) = words
    call merge_sums(sums, reshape(more, [words_of_sum, 1]))
    words = sums(:, 1)
  end subroutine merge_words

  subroutine shuffle(terms)
    real(dp), intent(inout) :: terms(:)
    real(dp) :: kept
    integer :: k, other
    do k = size(terms), 2, -1
      other = 1 + int(k*random())
      kept = terms(k)
      terms(k) = terms(other)
      terms(other) = kept
    end do
  end subroutine shuffle

  !> In [0, 1), the same in every run (Marsaglia 2003)
  real(dp) function random()
    seed = ieor(seed, shiftl(seed, 13))
    seed = ieor(seed, shiftr(seed, 7))
    seed = ieor(seed, shiftl(seed, 17))
    random = real(shiftr(seed, 11), dp)*2.0_dp**(-53)
  end function random

  pure logical function same(a, b)
    real(dp), intent(in) :: a, b
    same = transfer(a, 1_i8) == transfer(b, 1_i8)
  end function same

end program test_exact_sum
