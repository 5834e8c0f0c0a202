!> Particles that leave through a free side which takes material out
module gimp_leaving
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_over_ranks, only: any_rank, sum_columns
  use gimp_particles, only: few_chunks
  use gimp_material, only: most_states
  use gimp_chunk_state, only: chunk_law_deformation, chunk_history
  use gimp_run_state, only: stepper_t
  implicit none(type, external)
  private
  public :: mark_leaving

  integer, parameter :: n_removed = 6 !! energy and kinetic energy [J], momentum [kg m/s], number

contains

  !> Particles beyond a free side that takes material out; not allocated when no rank has any. Collective
  subroutine mark_leaving(s, leaving)
    type(stepper_t), intent(inout) :: s
    logical, allocatable, intent(out) :: leaving(:, :)
    logical, allocatable :: marks(:, :), marked(:)
    real(dp), allocatable :: part(:, :) ! (n_removed, group)
    real(dp) :: sums(n_removed)
    real(dp) :: x
    integer :: g, c, l, k
    associate (particles => s%engine%particles, grid => s%engine%grid)
      allocate (marks(lanes, particles%chunks), marked(size(particles%groups)), source=.false.)
      !$omp parallel do schedule(static) private(c, l, k, x) if(particles%chunks > few_chunks)
      do g = 1, size(particles%groups)
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (particles%id(l, c) == 0) cycle
            if (grid%is_mesh) marks(l, c) = particles%p(l, max(1, particles%element%first), c) < 0.0_wp ! the pass has seen it
            do k = 1, merge(0, grid%dim, grid%is_mesh)
              x = real(particles%p(l, k, c), dp) + particles%groups(g)%at(k)*grid%edge(k)
              if (s%walls%side(1, k)%removes .and. x < 0.0_dp) marks(l, c) = .true.
              if (s%walls%side(2, k)%removes .and. x > grid%cells(k)) marks(l, c) = .true.
            end do
            marked(g) = marked(g) .or. marks(l, c)
          end do
        end do
      end do
      !$omp end parallel do
      if (.not. any_rank(any(marked))) return
      allocate (part(n_removed, size(particles%groups)), source=0.0_dp)
      do g = 1, size(particles%groups)
        if (.not. marked(g)) cycle
        do c = particles%groups(g)%first, particles%groups(g)%last
          do l = 1, lanes
            if (marks(l, c)) call note_removed(particles%groups(g)%material, c, l, part(:, g))
          end do
        end do
      end do
    end associate
    call sum_columns(part, sums)
    s%books%removed = s%books%removed + sums(1)
    s%removed_kinetic = s%removed_kinetic + sums(2)
    s%books%impulse = s%books%impulse - sums(3:5)
    s%books%removed_particles = s%books%removed_particles + nint(sums(6), i8)
    call move_alloc(marks, leaving)

  contains

    !> Kinetic and stored energy leave with the particle
    subroutine note_removed(material, chunk, lane, sums)
      integer, intent(in) :: material, chunk, lane
      real(dp), intent(inout) :: sums(n_removed)
      real(wp) :: f(lanes, 9), energy(lanes), history(lanes, most_states)
      real(dp) :: moving
      integer :: d, v
      d = s%engine%grid%dim
      call chunk_law_deformation(s%engine%particles, chunk, f)
      call chunk_history(s%engine%particles, chunk, history)
      v = s%engine%particles%velocity%first
      associate (p => s%engine%particles%p, particles => s%engine%particles)
        call s%engine%laws(material)%law%stored_energy(f, history, energy)
        moving = 0.5_dp*p(lane, particles%mass%first, chunk)*sum(p(lane, v:v + d - 1, chunk)**2)
        sums(1) = sums(1) + moving + p(lane, particles%volume%first, chunk)*energy(lane)
        sums(2) = sums(2) + moving
        sums(3:2 + d) = sums(3:2 + d) + p(lane, particles%mass%first, chunk)*p(lane, v:v + d - 1, chunk)
        sums(6) = sums(6) + 1.0_dp
      end associate
    end subroutine note_removed

  end subroutine mark_leaving

end module gimp_leaving
