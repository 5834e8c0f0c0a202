!> What each particle of a scene stores, and why
module gimp_particle_fields
  use gimp_kinds, only: wp
  use gimp_particles, only: add_field
  use gimp_basis, only: basis_linear, basis_cpgimp, basis_ddmp, is_sampled
  use gimp_corner_domains, only: carried_none
  use gimp_snapshot, only: needs_reference
  use gimp_run_state, only: stepper_t, position_published, symplectic
  use gimp_engine, only: affine_none
  use gimp_cell_pass, only: evens_strain
  use gimp_loads, only: load_point
  use gimp_scene, only: scene_t, count_groups, word_of, texts_of
  implicit none(type, external)
  private
  public :: announce_fields

contains

  !> The fields that this scene stores, and nothing else
  subroutine announce_fields(scene, s, half)
    type(scene_t), intent(in) :: scene
    type(stepper_t), intent(inout) :: s
    real(wp), intent(in) :: half(3) !! half lengths [cells] if all particles share them, else zero
    character(len=64), allocatable :: fields(:)
    character(len=:), allocatable :: historic
    logical :: reference, face_loads
    integer :: d, k, states
    d = scene%dimension
    associate (p => s%engine%particles)
      p%dim = d
      call add_field(p, "position", d, p%position)
      call add_field(p, "velocity", d, p%velocity)
      call add_field(p, "deformation", d*d, p%deformation)
      call add_field(p, "mass", 1, p%mass)
      call add_field(p, "volume", 1, p%volume)
      allocate (fields, source=texts_of(scene, "output", 1, "fields"))
      reference = count_groups(scene, "verification") > 0
      do k = 1, size(fields)
        reference = reference .or. needs_reference(trim(fields(k)))
      end do
      face_loads = any(s%loads%load%kind /= load_point)
      p%uniform_half = half
      if (any(p%uniform_half(:d) <= 0.0_wp) .and. ((s%engine%basis /= basis_linear .and. s%engine%basis /= basis_ddmp) .or. face_loads)) then
        p%uniform_half = 0.0_wp
        call add_field(p, "half_length", d, p%half_length, "domains differ in size")
      end if
      if (s%engine%basis == basis_cpgimp) call add_field(p, "domain", d, p%domain, "basis = cpgimp")
      if (s%engine%rule%carried /= carried_none) then
        call add_field(p, "corner", d*s%engine%rule%n, p%corner, "basis = cpdi2")
        call add_field(p, "detached", 1, p%detached, "basis = cpdi2")
        if (s%engine%total_deformation) &
          call add_field(p, "reference_gradient", d*s%engine%rule%n, p%reference_gradient, "cpdi2_deformation = total")
      else if (is_sampled(s%engine%basis)) then
        call add_field(p, "domain", d*d, p%domain, "basis = "//word_of(scene, "method", 1, "basis"))
      end if
      if (s%engine%affine /= affine_none) call add_field(p, "affine", d*d, p%affine, &
        "transfer = "//word_of(scene, "method", 1, "transfer"))
      if (s%engine%total) call add_field(p, "displacement", d, p%displacement, "formulation = total")
      if (evens_strain(s%engine)) call add_field(p, "evened_deformation", d*d, p%evened, "anti_locking = " &
        //word_of(scene, "method", 1, "anti_locking"))
      if (s%method%position == position_published) call add_field(p, "motion", d, p%motion, &
        "position_update = published")
      if (s%method%integrator /= symplectic) call add_field(p, "acceleration", d, p%acceleration, &
        "integrator = "//word_of(scene, "method", 1, "integrator"))
      if (s%engine%grid%is_mesh) call add_field(p, "element", 1, p%element, "&mesh")
      if (s%engine%grid%is_mesh .and. is_sampled(s%engine%basis)) &
        call add_field(p, "point_element", (s%engine%rule%n + 1)/2, p%point_element, "points of domains in a mesh")
      if (reference) call add_field(p, "reference", d, p%reference, "verification or displacement in the output")
      if (allocated(s%engine%body_force)) call add_field(p, "force", d, p%force, "body force of the solution")
      if (face_loads) call add_field(p, "faces", 1, p%faces, "loads on faces")
      states = 0
      historic = ""
      do k = 1, size(s%engine%laws)
        states = max(states, s%engine%laws(k)%law%stored_states(d))
        if (s%engine%laws(k)%law%states > 0) historic = historic//" "//trim(s%engine%laws(k)%law%name)
      end do
      if (states > 0) call add_field(p, "state", states, p%state, "history of"//historic)
    end associate
  end subroutine announce_fields

end module gimp_particle_fields
