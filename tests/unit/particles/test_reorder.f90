!> Particles into a new order in place: any order, any number of threads, more or fewer chunks than before
program test_reorder
  use gimp_kinds, only: wp, i8, lanes
  use gimp_particles, only: particles_t, field_t, add_field, allot_chunks, clear_chunks, chunk_bytes, id_bytes
  use gimp_reorder, only: reorder_particles, reorder_bytes, first_real
  use gimp_storage, only: storage_t, reserve_storage
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check_true
  use omp_lib, only: omp_set_num_threads
  implicit none(type, external)

  integer, parameter :: threads(4) = [1, 2, 3, 8]
  integer :: t

  call begin_suite("reorder")
  do t = 1, size(threads)
    call omp_set_num_threads(threads(t))
    call test_order("the same order", 700, 700, stay)
    call test_order("a few chunks up", 700, 730, up)
    call test_order("a few chunks down", 700, 660, down)
    call test_order("neighbours change places", 700, 700, near)
    call test_order("a few from afar", 700, 700, exchange)
    call test_order("backwards", 700, 700, backwards)
    call test_order("fewer chunks than threads", 3, 2, down)
    call test_order("all gone", 40, 0, stay)
  end do
  call test_counts()
  call end_suite()

contains

  !> The old lane of new lane k, both from 0; -1 or beyond the old lanes: none
  pure integer(i8) function stay(k, old)
    integer(i8), intent(in) :: k, old
    stay = k + 0*old
  end function stay

  pure integer(i8) function up(k, old)
    integer(i8), intent(in) :: k, old
    up = k - 27*lanes*k/old - 3
  end function up

  pure integer(i8) function down(k, old)
    integer(i8), intent(in) :: k, old
    down = k + 36*lanes*k/old + 5
  end function down

  pure integer(i8) function near(k, old)
    integer(i8), intent(in) :: k, old
    near = min(old - 1, k + 0*old)
    if (k < old/100*100) near = k/100*100 + modulo(37*k, 100_i8)
  end function near

  !> Every 97th lane and its mirror change places
  pure integer(i8) function exchange(k, old)
    integer(i8), intent(in) :: k, old
    exchange = k
    if (modulo(min(k, old - 1 - k), 97_i8) == 5) exchange = old - 1 - k
  end function exchange

  pure integer(i8) function backwards(k, old)
    integer(i8), intent(in) :: k, old
    backwards = old - 1 - k
  end function backwards

  subroutine test_order(what, old, chunks, from)
    character(len=*), intent(in) :: what
    integer, intent(in) :: old, chunks
    interface
      pure integer(i8) function from(k, old)
        import :: i8
        implicit none(type, external)
        integer(i8), intent(in) :: k, old
      end function from
    end interface
    integer, parameter :: components = 13 ! no multiple of those that go together
    type(particles_t) :: particles
    type(field_t) :: other
    type(storage_t) :: buffer
    integer(i8), allocatable :: source(:, :)
    integer(i8) :: k
    integer :: c, l, f, wrong
    particles%dim = 3
    call add_field(particles, "position", 3, particles%position)
    call add_field(particles, "mass", 1, particles%mass)
    call add_field(particles, "volume", 1, particles%volume)
    call add_field(particles, "other", components - 5, other)
    call allot_chunks(particles, old)
    call clear_chunks(particles)
    do c = 1, old
      do l = 1, lanes
        particles%id(l, c) = lanes*(c - 1) + l
        do f = 1, components
          particles%p(l, f, c) = 100.0_wp*particles%id(l, c) + f
        end do
      end do
    end do
    allocate (source(lanes, chunks), source=-1_i8)
    do c = 1, chunks
      do l = 1, lanes
        if (modulo(c, 5) == 0 .and. l > 3) cycle ! some chunks have spare lanes
        k = from(int(lanes*(c - 1) + l - 1, i8), int(lanes, i8)*old)
        if (k >= 0 .and. k < int(lanes, i8)*old) source(l, c) = k
        if (l > 1) then
          if (source(l - 1, c) < 0) source(l, c) = -1
        end if
        if (l == 1 .and. source(l, c) < 0) source(l, c) = 0 ! the first lane is never spare
      end do
    end do
    call reserve_storage(buffer, reorder_bytes(chunks))
    block
      integer(i8), allocatable :: kept(:, :)
      kept = source
      call reorder_particles(particles, chunks, source, buffer%address)
      wrong = 0
      if (particles%chunks /= chunks .or. size(particles%p, 3) /= chunks) wrong = 1
      do c = 1, chunks
        do l = 1, lanes
          if (particles%id(l, c) /= kept(l, c) + 1) wrong = wrong + 1
          do f = 1, components
            if (kept(l, c) >= 0) then
              if (particles%p(l, f, c) /= 100.0_wp*(kept(l, c) + 1) + f) wrong = wrong + 1
            else if (f == 4 .or. f == 5) then
              if (particles%p(l, f, c) /= 0.0_wp) wrong = wrong + 1
            else if (particles%p(l, f, c) /= particles%p(1, f, c)) then
              wrong = wrong + 1
            end if
          end do
        end do
      end do
    end block
    call check_true(wrong == 0, what//", "//text_of(threads(t))//" threads")
  end subroutine test_order

  !> Sizes and places of 1e9 and 1e10 particles, without the memory
  subroutine test_counts()
    integer, parameter :: chunks = 1250000000, components = 17
    integer(i8), parameter :: particles = 10000000000_i8
    call check_true(int(lanes, i8)*chunks >= particles, "as many lanes as particles")
    call check_true(chunk_bytes(components, chunks)/real(chunks, wp) == lanes*components*storage_size(1.0_wp)/8, "bytes of fields")
    call check_true(id_bytes(chunks) == 8_i8*lanes*chunks, "bytes of numbers")
    call check_true(reorder_bytes(chunks) >= id_bytes(chunks), "bytes of the buffer of a sort")
    call check_true(first_real(components, int(lanes, i8)*chunks - 1) == int(lanes, i8)*components*chunks - lanes*components + lanes - 1, &
                    "where the last particle stands")
  end subroutine test_counts

end program test_reorder
