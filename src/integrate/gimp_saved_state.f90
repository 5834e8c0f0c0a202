!> The state of a run at the start of a step, kept so that the step can be undone: what particles are, the clock and the books.
!>
!> Blocks, images, pads and nodal values are not kept: blocks follow from the groups of the particles, the rest from one
!> transfer to the grid.
module gimp_saved_state
  use gimp_kinds, only: wp, dp, i8, lanes
  use gimp_storage, only: storage_t, reserve_storage
  use gimp_borders, only: build_tables
  use gimp_particles, only: particles_t, group_t, allot_chunks, chunk_bytes, id_bytes
  use gimp_engine, only: engine_t, allot_grid
  use gimp_books, only: books_t
  use, intrinsic :: iso_c_binding, only: c_f_pointer
  implicit none(type, external)
  private
  public :: saved_state_t, clock_t, save_particles, recall_particles, saved_bytes, recall_groups

  !> What a stepper remembers from step to step beside particles and books
  type :: clock_t
    real(dp) :: time = 0.0_dp !! of positions [s]
    integer(i8) :: step = 0
    integer(i8) :: particle_steps = 0
    real(dp) :: dt = 0.0_dp, free_dt = 0.0_dp !! last step, and the same before it was shortened for output [s]
    real(dp) :: kick_before = 0.0_dp !! [s]
    real(dp) :: rate = 0.0_dp, speed = 0.0_dp, strain_rate = 0.0_dp !! peaks of the last step [m/s], [m/s], [1/s]
    logical :: sort_now = .false.
    real(dp) :: kinetic_peak = 0.0_dp !! [J]
    real(dp) :: stored = 0.0_dp !! elastic energy [J]
    real(dp) :: power(2, 6) = 0.0_dp, pull(3) = 0.0_dp !! of Newmark
  end type clock_t

  !> One state
  type :: saved_state_t
    type(clock_t) :: clock
    type(books_t) :: books
    integer(i8), private :: n = 0, n_all = 0
    integer, private :: chunks = 0
    type(group_t), allocatable :: groups(:)
    integer, allocatable, private :: block_group(:)
    integer(i8), allocatable, private :: cut(:) ! which keys each rank owned
    real(wp), pointer, contiguous :: p(:, :, :) => null() !! (lane, component, chunk)
    integer(i8), pointer, contiguous :: id(:, :) => null() !! (lane, chunk)
    type(storage_t), private :: store, id_store
  end type saved_state_t

contains

  !> Bytes that a saved state takes
  pure integer(i8) function saved_bytes(saved)
    type(saved_state_t), intent(in) :: saved
    saved_bytes = 0
    if (associated(saved%p)) saved_bytes = size(saved%p, kind=i8)*(storage_size(1.0_wp)/8) &
                                         + size(saved%id, kind=i8)*(storage_size(1_i8)/8)
  end function saved_bytes

  !> Copy the particles; groups only where a sort has changed them
  subroutine save_particles(particles, cut, sorted, saved)
    type(particles_t), intent(in) :: particles
    integer(i8), allocatable, intent(in) :: cut(:) !! which keys each rank owns; not allocated for one rank
    logical, intent(in) :: sorted !! since they were saved last
    type(saved_state_t), intent(inout) :: saved
    if (sorted .or. .not. associated(saved%p)) then
      saved%n = particles%n
      saved%n_all = particles%n_all
      saved%chunks = particles%chunks
      saved%groups = particles%groups
      saved%block_group = particles%block_group
      if (allocated(cut)) saved%cut = cut
      call reserve_storage(saved%store, chunk_bytes(particles%components, particles%chunks))
      call c_f_pointer(saved%store%address, saved%p, [lanes, particles%components, particles%chunks])
      call reserve_storage(saved%id_store, id_bytes(particles%chunks))
      call c_f_pointer(saved%id_store%address, saved%id, [lanes, particles%chunks])
      saved%id = particles%id
    end if
    call copy_chunks(particles%components, particles%chunks, particles%p, saved%p)
  end subroutine save_particles

  !> Bring the saved particles back, in their order; pads and nodes have to be filled anew
  subroutine recall_particles(saved, sorted, engine)
    type(saved_state_t), intent(in) :: saved
    logical, intent(in) :: sorted !! since they were saved
    type(engine_t), intent(inout) :: engine
    if (sorted) then
      call allot_chunks(engine%particles, saved%chunks)
      engine%particles%id = saved%id
      engine%particles%n = saved%n
      engine%particles%n_all = saved%n_all
      engine%particles%groups = saved%groups
      engine%particles%block_group = saved%block_group
      if (allocated(saved%cut)) engine%border%cut = saved%cut
    end if
    call copy_chunks(engine%particles%components, saved%chunks, saved%p, engine%particles%p)
    if (sorted) call rebuild_blocks(engine)
  end subroutine recall_particles

  !> Room for particles in these groups, with the tables of blocks that follow from them; `p`, `id` and `n` are to be filled
  subroutine recall_groups(engine, groups)
    type(engine_t), intent(inout) :: engine
    type(group_t), intent(in) :: groups(:) !! in the order of blocks; every block has at least one
    logical :: begins(size(groups))
    integer :: g, chunks
    chunks = 0
    if (size(groups) > 0) chunks = groups(size(groups))%last
    call allot_chunks(engine%particles, chunks)
    engine%particles%groups = groups
    begins = .true.
    do g = 2, size(groups)
      begins(g) = groups(g)%block /= groups(g - 1)%block
    end do
    engine%particles%block_group = [pack([(g, g=1, size(groups))], begins), size(groups) + 1]
    call rebuild_blocks(engine)
  end subroutine recall_groups

  subroutine copy_chunks(components, chunks, from, to)
    integer, intent(in) :: components, chunks
    real(wp), intent(in) :: from(lanes, components, chunks)
    real(wp), intent(inout) :: to(lanes, components, chunks)
    integer :: c
    !$omp parallel do schedule(static)
    do c = 1, chunks
      to(:, :, c) = from(:, :, c)
    end do
    !$omp end parallel do
  end subroutine copy_chunks

  !> The tables of active blocks as the sort made them, from the blocks that the groups name
  subroutine rebuild_blocks(engine)
    type(engine_t), intent(inout) :: engine
    integer, allocatable :: at(:, :)
    integer :: b
    allocate (at(3, size(engine%particles%block_group) - 1))
    do b = 1, size(at, 2)
      at(:, b) = engine%particles%groups(engine%particles%block_group(b))%at
    end do
    call build_tables(engine, at)
    call allot_grid(engine)
  end subroutine rebuild_blocks

end module gimp_saved_state
