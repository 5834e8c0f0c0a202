!> gimp_roofline.x: the limits of this machine, in words or as JSON lines, so that a speed can be told as a share of them
program gimp_roofline
  use gimp_roofline_measures, only: rate_t, measure_fma, measure_stream, measure_round_trip
  use, intrinsic :: iso_fortran_env, only: real64, int64, error_unit
  use omp_lib, only: omp_get_num_procs
  implicit none(type, external)
  real(real64), parameter :: near_limit = 300.0_real64 ! ns; cores of one cluster took 84 to 230, others 420 and more
  logical :: json = .false.
  real(real64) :: seconds = 0.05_real64
  integer :: most = 0, megabytes = 320, pass, threads
  character(len=16) :: only = "all"

  call read_arguments()
  if (most < 1) most = omp_get_num_procs()
  if (only == "all" .or. only == "fma") then
    do pass = 1, min(2, most)
      threads = merge(1, most, pass == 1)
      call tell_fma(threads)
    end do
  end if
  if (only == "all" .or. only == "bandwidth") then
    do pass = 1, min(2, most)
      threads = merge(1, most, pass == 1)
      if (threads > 1) call tell_round_trips()
      call tell_stream("l1", threads, 1200_int64)
      call tell_stream("l2", threads, 24000_int64)
      call tell_stream("dram", threads, 125000_int64*megabytes)
    end do
  end if
  if (most > 1 .and. only /= "fma") call tell_round_trips() ! again: a virtual machine may move cores meanwhile

contains

  subroutine tell_fma(threads)
    integer, intent(in) :: threads
    type(rate_t) :: double, single
    double = measure_fma(threads, seconds, .false.)
    single = measure_fma(threads, seconds, .true.)
    if (json) then
      write (*, "(a,i0,5(a,es12.5),a)") '{"what":"fma","threads":', threads, ',"dp_gflops":', 1e-9*double%best, &
        ',"dp_median":', 1e-9*double%middle, ',"sp_gflops":', 1e-9*single%best, ',"sp_median":', 1e-9*single%middle, &
        ',"check":', double%check*single%check, '}'
    else
      write (*, "(a,t24,i3,a,2(f9.1,a,f9.1,a))") "fused multiply-add", threads, " threads", 1e-9*double%best, " (", &
        1e-9*double%middle, ") Gflop/s in double", 1e-9*single%best, " (", 1e-9*single%middle, ") in single precision"
    end if
    flush (6)
  end subroutine tell_fma

  subroutine tell_stream(level, threads, n)
    character(len=*), intent(in) :: level
    integer, intent(in) :: threads
    integer(int64), intent(in) :: n
    type(rate_t) :: threefold, in_place
    threefold = measure_stream(threads, seconds, n, .false.)
    in_place = measure_stream(threads, seconds, n, .true.)
    if (json) then
      write (*, "(3a,i0,a,i0,5(a,es12.5),a)") '{"what":"bandwidth_', level, '","threads":', threads, ',"array_bytes":', 8*n, &
        ',"triad_gbs":', 1e-9*threefold%best, ',"triad_median":', 1e-9*threefold%middle, ',"update_gbs":', 1e-9*in_place%best, &
        ',"update_median":', 1e-9*in_place%middle, ',"check":', threefold%check*in_place%check, '}'
    else
      write (*, "(2a,t24,i3,a,2(f9.1,a,f9.1,a))") "bandwidth ", level, threads, " threads", 1e-9*threefold%best, " (", &
        1e-9*threefold%middle, ") GB/s triad,      ", 1e-9*in_place%best, " (", 1e-9*in_place%middle, ") in place"
    end if
    flush (6)
  end subroutine tell_stream

  !> The nearest and the farthest partner of thread 0
  subroutine tell_round_trips()
    type(rate_t) :: trip, near, far
    integer :: partner
    do partner = 1, min(most, 16) - 1
      trip = measure_round_trip(partner, seconds)
      if (partner == 1) then
        near = trip
        far = trip
      end if
      if (trip%middle < near%middle) near = trip
      if (trip%middle > far%middle) far = trip
    end do
    if (json) then
      write (*, "(a,i0,4(a,es12.5),3a)") '{"what":"core_to_core","threads":', most, ',"best_ns":', near%best, ',"median_ns":', &
        near%middle, ',"farthest_best_ns":', far%best, ',"farthest_median_ns":', far%middle, ',"placement":"', &
        trim(merge("near", "far ", far%best < near_limit)), '"}'
    else
      write (*, "(a,t24,i3,a,2(f9.1,a,f9.1,a))") "cache line, round trip", most, " threads", near%best, " (", near%middle, &
        ") ns nearest,        ", far%best, " (", far%middle, ") farthest: "//trim(merge("near", "far ", far%best < near_limit))
    end if
    flush (6)
  end subroutine tell_round_trips

  subroutine read_arguments()
    character(len=32) :: word
    integer :: i
    i = 1
    do while (i <= command_argument_count())
      call get_command_argument(i, word)
      select case (word)
      case ("--json")
        json = .true.
      case ("--seconds")
        seconds = number_after(i, 1.0e-6_real64, 60.0_real64)
      case ("--threads")
        most = int(number_after(i, 1.0_real64, 4096.0_real64))
      case ("--megabytes")
        megabytes = int(number_after(i, 1.0_real64, 65536.0_real64))
      case ("--only")
        i = i + 1
        call get_command_argument(i, word)
        only = word(:16)
        if (only /= "fma" .and. only /= "bandwidth" .and. only /= "core_to_core") call refuse(word)
      case ("--help")
        call tell_help()
        stop
      case default
        call refuse(word)
      end select
      i = i + 1
    end do
  end subroutine read_arguments

  !> The number in the argument after the i-th
  real(real64) function number_after(i, lowest, highest) result(value)
    integer, intent(inout) :: i
    real(real64), intent(in) :: lowest, highest
    character(len=32) :: word
    integer :: stat
    i = i + 1
    call get_command_argument(i, word)
    read (word, *, iostat=stat) value
    if (stat /= 0) call refuse(word)
    if (.not. (value >= lowest .and. value <= highest)) call refuse(word)
  end function number_after

  subroutine refuse(word)
    character(len=*), intent(in) :: word
    write (error_unit, "(3a)") "gimp_roofline.x: '", trim(word), "' is not understood; --help tells what is"
    stop 2, quiet=.true.
  end subroutine refuse

  subroutine tell_help()
    write (*, "(a)") "gimp_roofline.x: what this machine can do at most; best of 11 repetitions (median in brackets)", "", &
      "  --json          JSON lines instead of words", &
      "  --seconds S     length of a repetition (0.05)", &
      "  --threads N     beside one thread (default: all processors)", &
      "  --megabytes M   size of each array in memory, a thread (320): several times the last cache", &
      "  --only WHAT     fma, bandwidth or core_to_core", "", &
      "Triad a = b + q*c counts 24 bytes an element, the update in place a = q*a + c 16. Near or far: whether a cache", &
      "line takes less than 300 ns to the farthest thread and back. Pin with OMP_PROC_BIND=true."
  end subroutine tell_help

end program gimp_roofline
