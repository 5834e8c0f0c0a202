!> Particles into a new order, in place, without a second copy of all of them.
!>
!> Most sorts move nearly every particle only a little way. Then each part of the chunks is renewed from its low end to its high
!> end: before a segment of it is overwritten its old particles go to a ring of the last few segments, small enough for the
!> cache, and the few particles that come from farther below or from another part are put aside before (the guests). Where too
!> many come from afar, as in the first sort of a run, a few components of all particles at a time go through the buffer.
module gimp_reorder
  use gimp_kinds, only: wp, i8, lanes
  use gimp_particles, only: particles_t, allot_chunks, id_bytes, chunk_bytes, few_chunks
  use omp_lib, only: omp_get_max_threads
  use, intrinsic :: iso_c_binding, only: c_ptr, c_f_pointer
  implicit none(type, external)
  private
  public :: reorder_particles, reorder_bytes, first_real

  integer, parameter :: together = 4 !! components that go through the buffer at once
  integer, parameter :: segment = 16 !! chunks

  !> Consecutive chunks that one thread renews
  type :: part_t
    integer :: first = 1, last = 0 !! chunks after the move
    integer :: last_old = 0 !! old chunks that lie in the part: `first` to this one
    integer :: depth = 0 !! segments below its own from which a segment still takes particles out of the ring
    integer(i8) :: guests = 0 !! particles from farther away
    integer(i8) :: ring = 0, guest = 0 !! where these two begin in the buffer, in reals from 0
    logical :: fits = .false. !! the buffer has room for both
  end type part_t

contains

  !> Bytes of the buffer for so many chunks
  pure integer(i8) function reorder_bytes(chunks)
    integer, intent(in) :: chunks
    reorder_bytes = max(chunk_bytes(together, chunks), id_bytes(chunks))
  end function reorder_bytes

  !> New lane k takes the particle of old lane source(k); particles that no lane takes are gone
  subroutine reorder_particles(particles, chunks, source, buffer)
    type(particles_t), intent(inout) :: particles
    integer, intent(in) :: chunks !! after the move
    integer(i8), intent(inout) :: source(lanes, chunks) !! old lanes, counted from 0 through all chunks; -1: spare. Used up
    type(c_ptr), intent(in) :: buffer !! `reorder_bytes` bytes on a cache line
    type(part_t), allocatable :: parts(:)
    real(wp), pointer, contiguous :: part(:, :, :)
    integer(i8), pointer, contiguous :: ids(:, :)
    integer :: room
    if (chunks == 0) then
      call allot_chunks(particles, 0)
      return
    end if
    room = max(particles%chunks, chunks)
    call allot_chunks(particles, room)
    call c_f_pointer(buffer, ids, [lanes, chunks])
    call carry_ids(chunks, source, particles%id, ids)
    call c_f_pointer(buffer, part, [lanes, together, chunks])
    call plan_parts(particles%components, room, chunks, source, parts)
    if (all(parts%fits)) then
      call carry_near(parts, particles%components, room, chunks, source, particles%p, part)
    else
      call carry_far(particles%components, room, chunks, source, particles%p, part)
    end if
    call allot_chunks(particles, chunks)
    call weigh_spare_lanes(particles)
  end subroutine reorder_particles

  !> Numbers to their new lanes
  subroutine carry_ids(chunks, source, id, ids)
    integer, intent(in) :: chunks
    integer(i8), intent(in) :: source(lanes, chunks)
    integer(i8), intent(inout) :: id(0:*)
    integer(i8), intent(out) :: ids(lanes, chunks)
    integer :: c, l
    integer(i8) :: at
    !$omp parallel private(l, at) if(chunks > few_chunks)
    !$omp do schedule(static)
    do c = 1, chunks
      do l = 1, lanes
        ids(l, c) = 0_i8
        if (source(l, c) >= 0) ids(l, c) = id(source(l, c))
      end do
    end do
    !$omp end do
    !$omp do schedule(static)
    do c = 1, chunks
      at = (c - 1_i8)*lanes
      do l = 1, lanes
        id(at + l - 1) = ids(l, c)
      end do
    end do
    !$omp end do
    !$omp end parallel
  end subroutine carry_ids

  !> Equal parts of the chunks, each with its share of the buffer, and what each needs of it
  subroutine plan_parts(components, room, chunks, source, parts)
    integer, intent(in) :: components, room, chunks
    integer(i8), intent(in) :: source(lanes, chunks)
    type(part_t), allocatable, intent(out) :: parts(:)
    integer :: k, n
    n = max(1, min(omp_get_max_threads(), chunks/few_chunks))
    allocate (parts(n))
    !$omp parallel do schedule(static, 1) if(n > 1)
    do k = 1, n
      parts(k)%first = 1 + int(int(chunks, i8)*(k - 1)/n)
      parts(k)%last = int(int(chunks, i8)*k/n)
      parts(k)%last_old = merge(room, parts(k)%last, k == n)
      call plan_part(components, source, parts(k))
    end do
    !$omp end parallel do
  end subroutine plan_parts

  !> Depth of the ring and number of guests of one part
  subroutine plan_part(components, source, part)
    integer, intent(in) :: components
    integer(i8), intent(in) :: source(lanes, *)
    type(part_t), intent(inout) :: part
    integer(i8), allocatable :: from(:) ! (depth) particles that come from so many segments below
    integer(i8) :: share, most_guests
    integer :: c, l, deepest, depth
    share = int(lanes, i8)*together*(part%last - part%first + 1)
    part%guest = int(lanes, i8)*together*(part%first - 1)
    most_guests = share/4/components
    part%ring = part%guest + share/4
    deepest = int((share - share/4)/(int(lanes, i8)*components*segment)) - 1
    part%fits = deepest >= 0 .or. part%last < part%first
    if (deepest < 0) return
    allocate (from(0:deepest + 1), source=0_i8)
    do c = part%first, part%last
      do l = 1, lanes
        if (source(l, c) < 0) cycle
        depth = depth_of(part, c, source(l, c))
        if (depth > 0) from(min(depth, deepest + 1)) = from(min(depth, deepest + 1)) + 1
      end do
    end do
    part%guests = from(deepest + 1)
    part%fits = part%guests <= most_guests
    part%depth = deepest
    do while (part%depth > 0) ! a shallow ring stays in cache
      if (part%guests + from(part%depth) > most_guests/4) exit
      part%guests = part%guests + from(part%depth)
      part%depth = part%depth - 1
    end do
  end subroutine plan_part

  !> How many segments below chunk c the chunk of an old lane lies; a huge number when it is in another part
  pure integer function depth_of(part, c, lane) result(depth)
    type(part_t), intent(in) :: part
    integer, intent(in) :: c
    integer(i8), intent(in) :: lane
    integer :: old
    old = int(lane/lanes) + 1
    depth = huge(1)
    if (old < part%first .or. old > part%last_old) return
    depth = (c - part%first)/segment - (old - part%first)/segment
  end function depth_of

  !> Carry all components where most particles come from near
  subroutine carry_near(parts, components, room, chunks, source, p, buffer)
    type(part_t), intent(in) :: parts(:)
    integer, intent(in) :: components, room, chunks
    integer(i8), intent(inout) :: source(lanes, chunks)
    real(wp), intent(inout) :: p(0:int(lanes, i8)*components*room - 1)
    real(wp), intent(inout) :: buffer(0:int(lanes, i8)*together*chunks - 1)
    integer :: k
    !$omp parallel if(size(parts) > 1)
    !$omp do schedule(static, 1)
    do k = 1, size(parts)
      call save_guests(parts(k), components, source, p, buffer(parts(k)%guest))
    end do
    !$omp end do
    !$omp do schedule(static, 1)
    do k = 1, size(parts)
      call renew_part(parts(k), components, source, p, buffer(parts(k)%guest), buffer(parts(k)%ring))
    end do
    !$omp end do
    !$omp end parallel
  end subroutine carry_near

  !> Put the guests of a part aside; the source of guest k (from 0) becomes -2 - k
  subroutine save_guests(part, components, source, p, guest)
    type(part_t), intent(in) :: part
    integer, intent(in) :: components
    integer(i8), intent(inout) :: source(lanes, *)
    real(wp), intent(in) :: p(0:*)
    real(wp), intent(inout) :: guest(components, 0:*)
    integer(i8) :: at, n
    integer :: c, l, f
    n = 0
    if (part%guests == 0) return
    do c = part%first, part%last
      do l = 1, lanes
        if (source(l, c) < 0) cycle
        if (depth_of(part, c, source(l, c)) <= part%depth) cycle
        at = first_real(components, source(l, c))
        do f = 1, components
          guest(f, n) = p(at + (f - 1)*lanes)
        end do
        source(l, c) = -2 - n
        n = n + 1
      end do
    end do
  end subroutine save_guests

  !> Where the first component of a lane stands, in reals from 0 through all chunks
  pure integer(i8) function first_real(components, lane)
    integer, intent(in) :: components
    integer(i8), intent(in) :: lane
    first_real = lane/lanes*(lanes*components) + modulo(lane, int(lanes, i8))
  end function first_real

  !> Renew the chunks of a part in ascending order
  subroutine renew_part(part, components, source, p, guest, ring)
    type(part_t), intent(in) :: part
    integer, intent(in) :: components
    integer(i8), intent(in) :: source(lanes, *)
    real(wp), intent(inout) :: p(0:*)
    real(wp), intent(in) :: guest(components, 0:*)
    real(wp), intent(inout) :: ring(0:*)
    real(wp) :: chunk(lanes, components)
    integer(i8) :: at, part_at, in_part, slot
    integer :: s, c, l, f, length
    length = lanes*components*segment
    part_at = (part%first - 1_i8)*lanes*components
    do s = 0, (part%last - part%first + segment)/segment - 1
      slot = int(length, i8)*modulo(s, part%depth + 1)
      at = part_at + int(length, i8)*s
      do f = 0, lanes*components*min(segment, part%last_old - part%first - s*segment + 1) - 1
        ring(slot + f) = p(at + f)
      end do
      do c = part%first + s*segment, min(part%last, part%first + (s + 1)*segment - 1)
        do l = 1, lanes
          if (source(l, c) >= 0) then
            in_part = first_real(components, source(l, c)) - part_at
            if (in_part < int(length, i8)*(s + 1)) then
              at = modulo(in_part/length, part%depth + 1_i8)*length + modulo(in_part, int(length, i8))
              do f = 1, components
                chunk(l, f) = ring(at + (f - 1)*lanes)
              end do
            else
              do f = 1, components
                chunk(l, f) = p(part_at + in_part + (f - 1)*lanes)
              end do
            end if
          else if (source(l, c) == -1) then
            chunk(l, :) = chunk(1, :) ! lane 1 is never spare; a twin of it moves as a real particle does, and weighs nothing
          else
            chunk(l, :) = guest(:, -2 - source(l, c))
          end if
        end do
        at = (c - 1_i8)*lanes*components
        do f = 1, components
          do l = 1, lanes
            p(at + (f - 1)*lanes + l - 1) = chunk(l, f)
          end do
        end do
      end do
    end do
  end subroutine renew_part

  !> Carry all components where many particles come from afar, a few components at a time
  subroutine carry_far(components, room, chunks, source, p, part)
    integer, intent(in) :: components, room, chunks
    integer(i8), intent(inout) :: source(lanes, chunks)
    real(wp), intent(inout) :: p(0:int(lanes, i8)*components*room - 1)
    real(wp), intent(inout) :: part(lanes, together, chunks)
    integer(i8) :: at
    integer :: c, l, f, k, last
    !$omp parallel private(l, f, k, at, last) if(chunks > few_chunks)
    !$omp do schedule(static)
    do c = 1, chunks
      do l = 1, lanes
        if (source(l, c) < 0) then
          source(l, c) = source(1, c) ! a twin, as above
        else
          source(l, c) = first_real(components, source(l, c))
        end if
      end do
    end do
    !$omp end do
    do f = 0, components - 1, together
      last = min(together, components - f)
      !$omp do schedule(static)
      do c = 1, chunks
        do k = 1, last
          do l = 1, lanes
            part(l, k, c) = p(source(l, c) + (f + k - 1)*lanes)
          end do
        end do
      end do
      !$omp end do
      !$omp do schedule(static)
      do c = 1, chunks
        at = ((c - 1_i8)*components + f)*lanes
        do k = 1, last
          do l = 1, lanes
            p(at + (k - 1)*lanes + l - 1) = part(l, k, c)
          end do
        end do
      end do
      !$omp end do
    end do
    !$omp end parallel
  end subroutine carry_far

  !> Spare lanes have no mass, no volume and no force
  subroutine weigh_spare_lanes(particles)
    type(particles_t), intent(inout) :: particles
    integer :: c, l, q
    !$omp parallel do schedule(static) private(l, q) if(particles%chunks > few_chunks)
    do c = 1, particles%chunks
      if (particles%id(lanes, c) > 0) cycle ! spare lanes come last
      do l = 2, lanes
        if (particles%id(l, c) > 0) cycle
        particles%p(l, particles%mass%first, c) = 0.0_wp
        particles%p(l, particles%volume%first, c) = 0.0_wp
        q = particles%force%first
        if (q > 0) particles%p(l, q:q + particles%dim - 1, c) = 0.0_wp
        if (particles%faces%first > 0) particles%p(l, particles%faces%first, c) = 0.0_wp
      end do
    end do
    !$omp end parallel do
  end subroutine weigh_spare_lanes

end module gimp_reorder
