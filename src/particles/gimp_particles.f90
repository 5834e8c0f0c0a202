!> The particles of one rank: chunks of `lanes`, arrays of structures of arrays.
!>
!> Order: block, material, cell, id. Each (block, material) group starts a new chunk; spare lanes have no mass. Positions are
!> relative to the particle's block, in units of the spacing, so that they keep their precision far from the origin and
!> every kernel sees the same cell. One list of fields says what this scene stores; sorting, checks and output walk it.
module gimp_particles
  use gimp_kinds, only: wp, i8, lanes
  use gimp_storage, only: storage_t, extend_storage, real_bytes
  use, intrinsic :: iso_c_binding, only: c_f_pointer
  implicit none(type, external)
  private
  public :: particles_t, field_t, group_t, add_field, allot_chunks, clear_chunks, live_bytes, chunk_bytes, id_bytes, few_chunks

  integer, parameter :: few_chunks = 64 !! up to so many are not worth waking other threads for

  !> A named quantity and where its components sit in a chunk
  type :: field_t
    character(len=24) :: name = ""
    integer :: first = 0 !! index of its first component; 0: not stored in this scene
    integer :: components = 0
    character(len=80) :: reason = "" !! what in the scene asks for it; empty: every scene stores it
  end type field_t

  !> Consecutive chunks of one block and one material
  type :: group_t
    integer :: block = 0
    integer :: material = 0
    integer :: first = 1 !! first chunk
    integer :: last = 0 !! last chunk
    integer :: at(3) = 0 !! block coordinates that positions refer to
  end type group_t

  !> Particles in chunks of `lanes`; a chunk never spans two groups, spare lanes have zero mass
  type :: particles_t
    integer :: dim = 0
    integer(i8) :: n = 0 !! live particles of this rank
    integer(i8) :: n_all = 0 !! of all ranks
    integer :: chunks = 0
    integer :: components = 0 !! of all fields together
    type(field_t), allocatable :: fields(:) !! what this scene stores: the one list all else walks
    type(field_t) :: position, velocity, deformation, mass, volume !! always stored, in this order
    type(field_t) :: half_length !! initial half lengths in cells, when they differ between particles
    type(field_t) :: domain !! present half lengths in cells (cpgimp), or half-edge vectors (cpdi, gauss_gimp)
    type(field_t) :: displacement !! since the start [cells], where positions stay at the start (total Lagrangian)
    type(field_t) :: corner !! of domains whose corners move with the grid, relative to the block [cells]
    type(field_t) :: detached !! 1: that domain had degenerated and follows F since; else 0
    type(field_t) :: reference_gradient !! g of the corners in the reference shape of the domain [1/cells]
    type(field_t) :: reference !! position at the start, from the corner of the box [cells]
    type(field_t) :: force !! external force on the particle [N]
    type(field_t) :: faces !! bit mask of loaded faces, as a whole number
    type(field_t) :: affine !! velocity gradient that the particle carries (apic, tpic), row by row [1/s]
    type(field_t) :: evened !! deformation gradient that laws see, when its changes of volume are averaged over cells
    type(field_t) :: motion !! velocity that the particle moves with, where it is not one of the grid [m/s]
    type(field_t) :: acceleration !! of the last force (generalised alpha, Newmark) [m/s2]
    type(field_t) :: element !! of the mesh, that the particle is in; negative: beyond a side that takes it out
    type(field_t) :: point_element !! elements that the points of its domain were in, two in a number; 0: not known
    type(field_t) :: state !! history of the material
    real(wp), pointer, contiguous :: p(:, :, :) => null() !! (lane, component, chunk)
    integer(i8), pointer, contiguous :: id(:, :) => null() !! (lane, chunk) global number, kept for life; 0: spare lane
    type(group_t), allocatable :: groups(:)
    integer, allocatable :: block_group(:) !! (blocks + 1) first group of each block
    real(wp) :: uniform_half(3) = 0.0_wp !! initial half lengths in cells, when all particles share them
    type(storage_t), private :: store, id_store
  end type particles_t

contains

  !> Announce a quantity; done once, while the scene is set up
  subroutine add_field(self, name, components, field, reason)
    type(particles_t), intent(inout) :: self
    character(len=*), intent(in) :: name
    integer, intent(in) :: components
    type(field_t), intent(out) :: field !! keep it: it says where the quantity lives
    character(len=*), intent(in), optional :: reason !! what in the scene asks for it, in words of the scene
    if (.not. allocated(self%fields)) allocate (self%fields(0))
    field = field_t(name, self%components + 1, components)
    if (present(reason)) field%reason = reason
    self%fields = [self%fields, field]
    self%components = self%components + components
  end subroutine add_field

  !> Room for `chunks` chunks; the first ones are kept, new ones hold anything
  subroutine allot_chunks(self, chunks)
    type(particles_t), intent(inout) :: self
    integer, intent(in) :: chunks
    call extend_storage(self%store, chunk_bytes(self%components, chunks))
    call c_f_pointer(self%store%address, self%p, [lanes, self%components, chunks])
    call extend_storage(self%id_store, id_bytes(chunks))
    call c_f_pointer(self%id_store%address, self%id, [lanes, chunks])
    self%chunks = chunks
  end subroutine allot_chunks

  !> Empty all chunks; the thread that will work on a chunk is the first to touch its memory
  subroutine clear_chunks(self)
    type(particles_t), intent(inout) :: self
    integer :: c
    !$omp parallel do schedule(static)
    do c = 1, self%chunks
      self%p(:, :, c) = 0.0_wp
      self%id(:, c) = 0_i8
    end do
    !$omp end parallel do
  end subroutine clear_chunks

  !> Bytes of the fields of so many chunks
  pure integer(i8) function chunk_bytes(components, chunks)
    integer, intent(in) :: components, chunks
    chunk_bytes = real_bytes*lanes*components*chunks
  end function chunk_bytes

  !> Bytes of the numbers of so many chunks
  pure integer(i8) function id_bytes(chunks)
    integer, intent(in) :: chunks
    id_bytes = int(storage_size(1_i8)/8, i8)*lanes*chunks
  end function id_bytes

  !> Bytes of state that one particle needs (its fields and its number)
  pure integer function live_bytes(self)
    type(particles_t), intent(in) :: self
    live_bytes = self%components*(storage_size(1.0_wp)/8) + storage_size(1_i8)/8
  end function live_bytes

end module gimp_particles
