!> How fast this machine can add, multiply, stream and talk between cores
!>
!> A repetition is timed from before the common start of all threads to after their common end, so that a thread that starts
!> late cannot shorten it. Sweeps are first doubled until one repetition takes `seconds`. `check` is what the loop
!> computed, 1 or 3: whoever reads it knows that the loop was run.
module gimp_roofline_measures
  use gimp_roofline_kernels, only: fma_double, fma_single, triad, update
  use, intrinsic :: iso_fortran_env, only: real64, real32, int64
  use, intrinsic :: iso_c_binding, only: c_loc
  use omp_lib, only: omp_get_wtime, omp_get_thread_num
  implicit none(type, external)
  private
  public :: rate_t, measure_fma, measure_stream, measure_round_trip, median, repetitions

  integer, parameter :: repetitions = 11

  !> Work per second over the repetitions (the round trip: its nanoseconds)
  type :: rate_t
    real(real64) :: best = 0.0_real64, middle = 0.0_real64 !! middle: the median
    real(real64) :: check = 0.0_real64
  end type rate_t

contains

  !> Fused multiply-adds [flop/s] of all threads together
  type(rate_t) function measure_fma(threads, seconds, single) result(rate)
    integer, intent(in) :: threads
    real(real64), intent(in) :: seconds !! of one repetition
    logical, intent(in) :: single
    real(real64) :: x(8, 12), took(0:repetitions), start
    real(real32) :: y(16, 12)
    integer(int64) :: sweeps, tried
    integer :: r
    sweeps = 64
    tried = 0
    !$omp parallel num_threads(threads) private(x, y, r)
    x = 2.0_real64
    y = 2.0_real32
    r = 0
    do while (r <= repetitions)
      !$omp barrier
      if (omp_get_thread_num() == 0) start = omp_get_wtime()
      !$omp barrier
      if (single) then
        call fma_single(y, sweeps, 0.5_real32, 0.5_real32)
      else
        call fma_double(x, sweeps, 0.5_real64, 0.5_real64)
      end if
      !$omp barrier
      if (omp_get_thread_num() == 0) call book(omp_get_wtime() - start, seconds, sweeps, took(r), tried)
      !$omp barrier
      if (r > 0 .or. tried < 0) r = r + 1
    end do
    if (omp_get_thread_num() == 0) rate%check = merge(real(y(1, 1), real64), x(1, 1), single)
    !$omp end parallel
    call finish(rate, took, 2.0_real64*12*merge(16, 8, single)*100*real(sweeps, real64)*threads)
  end function measure_fma

  !> Bytes per second of all threads together, each with `n` elements of its own an array (first touched by it)
  type(rate_t) function measure_stream(threads, seconds, n, in_place) result(rate)
    integer, intent(in) :: threads
    real(real64), intent(in) :: seconds
    integer(int64), intent(in) :: n
    logical, intent(in) :: in_place !! update, else triad
    real(real64), allocatable, target :: a(:), b(:), c(:)
    real(real64) :: took(0:repetitions), start
    integer(int64) :: sweeps, tried
    integer :: r, i, j, k
    sweeps = 2 ! stays even: then the triad ends with q = 1
    tried = 0
    !$omp parallel num_threads(threads) private(a, b, c, r, i, j, k)
    allocate (a(n + 8), source=2.0_real64)
    allocate (b(merge(8_int64, n + 8, in_place)), c(merge(8_int64, n + 8, in_place)))
    b = 1.0_real64
    c = 2.0_real64
    i = first_on_line(a)
    j = first_on_line(b)
    k = first_on_line(c)
    r = 0
    do while (r <= repetitions)
      !$omp barrier
      if (omp_get_thread_num() == 0) start = omp_get_wtime()
      !$omp barrier
      if (in_place) then
        call update(n, a(i:), 0.5_real64, 0.5_real64, sweeps)
      else
        call triad(n, a(i:), b(j:), c(k:), sweeps)
      end if
      !$omp barrier
      if (omp_get_thread_num() == 0) call book(omp_get_wtime() - start, seconds, sweeps, took(r), tried)
      !$omp barrier
      if (r > 0 .or. tried < 0) r = r + 1
    end do
    if (omp_get_thread_num() == 0) rate%check = a(i + n/2)
    !$omp end parallel
    call finish(rate, took, merge(16.0_real64, 24.0_real64, in_place)*real(n, real64)*real(sweeps, real64)*threads)
  end function measure_stream

  !> Nanoseconds for one cache line to go from thread 0 to thread `partner` and back; `seconds` for all repetitions
  type(rate_t) function measure_round_trip(partner, seconds) result(rate)
    integer, intent(in) :: partner
    real(real64), intent(in) :: seconds
    real(real64) :: took(repetitions), start, began, now
    integer :: flag, seen, me, r, trip, trips, done
    flag = 0
    done = 0
    !$omp parallel num_threads(partner + 1) private(seen, me, r, trip, trips, start, now) shared(flag, done)
    me = omp_get_thread_num()
    !$omp barrier
    began = omp_get_wtime()
    !$omp barrier
    if (me == 0) then
      do r = 0, repetitions ! the first one, to get going, is short: two threads on one processor take for ever
        trips = merge(5, 500, r == 0)
        start = omp_get_wtime()
        do trip = 1, trips
          !$omp atomic write
          flag = 2*trip - 1 ! the partner's turn
          do
            !$omp atomic read
            seen = flag
            if (seen == 2*trip) exit
          end do
        end do
        now = omp_get_wtime()
        done = max(r, 1)
        took(done) = (now - start)/trips*1.0e9_real64
        if ((r == 0 .or. r >= 3) .and. now - began > seconds) exit
      end do
      !$omp atomic write
      flag = -1
    else if (me == partner) then
      do
        !$omp atomic read
        seen = flag
        if (seen < 0) exit
        if (mod(seen, 2) == 0) cycle
        !$omp atomic write
        flag = seen + 1
      end do
    end if
    !$omp end parallel
    rate = rate_t(minval(took(:done)), median(took(:done)), 1.0_real64)
  end function measure_round_trip

  !> Keep the time of a repetition; while `tried` is not negative, look for a number of sweeps that takes long enough
  pure subroutine book(time, seconds, sweeps, took, tried)
    real(real64), intent(in) :: time, seconds
    integer(int64), intent(inout) :: sweeps, tried
    real(real64), intent(out) :: took
    took = time
    if (tried < 0) return
    tried = tried + 1
    if (time >= 0.7_real64*seconds .or. tried > 40) then
      tried = -1
    else
      sweeps = 2*sweeps
    end if
  end subroutine book

  !> Rates from times; time 0 belongs to the search for the number of sweeps
  pure subroutine finish(rate, took, work)
    type(rate_t), intent(inout) :: rate
    real(real64), intent(in) :: took(0:), work
    rate%best = work/minval(took(1:))
    rate%middle = work/median(took(1:))
  end subroutine finish

  !> Index of the first element that begins a cache line of 64 bytes
  integer function first_on_line(a) result(first)
    real(real64), intent(in), target :: a(:)
    first = 1 + int(modulo(-transfer(c_loc(a(1)), 0_int64), 64_int64))/8
  end function first_on_line

  !> The middle one of some numbers
  pure real(real64) function median(values)
    real(real64), intent(in) :: values(:)
    integer :: i
    median = values(1)
    do i = 1, size(values)
      if (count(values < values(i)) <= size(values)/2 .and. count(values <= values(i)) > size(values)/2) median = values(i)
    end do
  end function median

end module gimp_roofline_measures
