!> Particles into a new order, in place: a few components at a time go through a buffer, so that there is no second copy of
!> all of them. Every chunk is written by the thread that a static schedule gives it to.
module gimp_reorder
  use gimp_kinds, only: wp, i8, lanes
  use gimp_particles, only: particles_t, allot_chunks, id_bytes, chunk_bytes
  use, intrinsic :: iso_c_binding, only: c_ptr, c_f_pointer
  implicit none(type, external)
  private
  public :: reorder_particles, reorder_bytes

  integer, parameter :: together = 4 !! components that go through the buffer at once

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
    integer(i8), intent(inout) :: source(lanes, chunks) !! old lanes, counted from 0 through all chunks; negative: spare. Used up
    type(c_ptr), intent(in) :: buffer !! `reorder_bytes` bytes on a cache line
    real(wp), pointer, contiguous :: part(:, :, :)
    integer(i8), pointer, contiguous :: ids(:, :)
    integer :: old
    old = particles%chunks
    call allot_chunks(particles, max(old, chunks))
    call c_f_pointer(buffer, ids, [lanes, chunks])
    call carry_ids(chunks, source, particles%id, ids)
    call c_f_pointer(buffer, part, [lanes, together, chunks])
    call carry_components(particles%components, particles%chunks, chunks, source, particles%p, part)
    call allot_chunks(particles, chunks)
    call weigh_spare_lanes(particles)
  end subroutine reorder_particles

  !> Numbers to their new lanes; afterwards `source` tells where the first component of a lane's particle lies
  subroutine carry_ids(chunks, source, id, ids)
    integer, intent(in) :: chunks
    integer(i8), intent(in) :: source(lanes, chunks)
    integer(i8), intent(inout) :: id(0:*)
    integer(i8), intent(out) :: ids(lanes, chunks)
    integer :: c, l
    integer(i8) :: at
    !$omp parallel private(l, at)
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

  !> All components to their new lanes; spare lanes become twins of their chunk's first particle
  subroutine carry_components(components, room, chunks, source, p, part)
    integer, intent(in) :: components, room, chunks
    integer(i8), intent(inout) :: source(lanes, chunks)
    real(wp), intent(inout) :: p(0:int(lanes, i8)*components*room - 1)
    real(wp), intent(inout) :: part(lanes, together, chunks)
    integer(i8) :: at
    integer :: c, l, f, k, last
    !$omp parallel private(l, f, k, at, last)
    !$omp do schedule(static)
    do c = 1, chunks
      do l = 1, lanes
        if (source(l, c) < 0) then
          source(l, c) = source(1, c) ! lane 1 is never spare; a twin of it moves as a real particle does, and weighs nothing
        else
          source(l, c) = source(l, c)/lanes*(lanes*components) + modulo(source(l, c), int(lanes, i8))
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
  end subroutine carry_components

  !> Spare lanes have no mass, no volume and no force
  subroutine weigh_spare_lanes(particles)
    type(particles_t), intent(inout) :: particles
    integer :: c, l, q
    !$omp parallel do schedule(static) private(l, q)
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
