!> What lies scattered over ranks comes to its place, whatever is missing and however few there are
program test_slabs
  use gimp_common_kinds, only: dp, i8
  use gimp_text, only: text_of
  use gimp_ranks, only: this_rank, ranks, backend, start_ranks, end_ranks
  use gimp_over_ranks, only: any_rank, sum_counts
  use gimp_slabs, only: slab_t, slab_of, delivery_t, plan_delivery, bring_to_slab, close_gaps
  use gimp_check, only: begin_suite, suite_failed, check_true
  implicit none(type, external)
  integer, parameter :: lanes = 8
  integer(i8) :: n

  call start_ranks()
  call begin_suite("slabs, "//trim(backend)//", "//text_of(this_rank)//" of "//text_of(ranks))
  call test_ranges()
  do n = 0, 9
    call test_delivery(n, 1)
    call test_delivery(n, 3)
  end do
  call test_delivery(1000_i8, 1)
  call test_delivery(1000_i8, 3)
  call end_ranks(merge(1, 0, any_rank(suite_failed())))

contains

  !> Slabs follow one another, none is larger than it must be
  subroutine test_ranges()
    type(slab_t) :: slab
    integer(i8) :: m
    do m = 0, 40
      slab = slab_of(m)
      call check_true(sum_counts(slab%mine) == m, "slabs together hold all places")
      call check_true(slab%before == min(m, this_rank*slab%width), "and none twice")
      call check_true(slab%mine >= 0 .and. slab%mine <= (m + ranks - 1)/ranks, "in shares as equal as can be")
    end do
  end subroutine test_ranges

  !> Items 1..m, of which those divisible by `gap` are missing if it is more than 1, lie about on all ranks but the first
  subroutine test_delivery(m, gap)
    integer(i8), intent(in) :: m
    integer, intent(in) :: gap
    integer(i8), allocatable :: number(:, :), place(:, :), slot(:, :), living(:)
    real(dp), allocatable :: values(:, :)
    type(delivery_t) :: delivery
    integer(i8) :: k, q
    integer :: i, c, home
    character(len=:), allocatable :: name
    name = text_of(m)//" numbers, gaps "//text_of(gap)//": "
    living = pack([(k, k=1, m)], [(gap == 1 .or. modulo(k, int(gap, i8)) /= 0, k=1, m)])
    allocate (number(lanes, 1 + m), source=0_i8) ! with empty lanes in all chunks
    c = 1 + int(m)
    do q = 1, size(living) ! in no order of numbers
      k = living(1 + modulo(7919*q, size(living, kind=i8)))
      if (modulo(int(size(living)), 7919) == 0) k = living(q)
      home = 0
      if (ranks > 1) home = 1 + modulo(int(k*k/3), ranks - 1)
      if (home /= this_rank) cycle
      number(1 + modulo(int(k), lanes), c) = k
      c = c - 1
    end do
    allocate (place, slot, mold=number)
    call close_gaps(merge(m, 0_i8, size(living) > 0), number, place)
    call check_true(all((place > 0) .eqv. (number > 0)), name//"empty lanes have no place")
    do c = 1, size(number, 2)
      do i = 1, lanes
        if (number(i, c) == 0) cycle
        if (place(i, c) /= count(living <= number(i, c))) call check_true(.false., name//"place in the order of numbers")
      end do
    end do
    call plan_delivery(slab_of(size(living, kind=i8)), place, delivery, slot)
    allocate (values(2, count(number > 0)))
    do c = 1, size(number, 2)
      do i = 1, lanes
        if (slot(i, c) > 0) values(:, slot(i, c)) = [real(dp) :: number(i, c), -0.5_dp*number(i, c)]
      end do
    end do
    call bring_to_slab(delivery, values)
    associate (slab => delivery%slab)
      call check_true(all(shape(values) == [2_i8, slab%mine]), name//"all places of the slab")
      call check_true(all(values(1, :) == living(slab%before + 1:slab%before + slab%mine)), name//"what belongs there")
      call check_true(all(values(2, :) == -0.5_dp*values(1, :)), name//"with all components")
    end associate
  end subroutine test_delivery

end program test_slabs
