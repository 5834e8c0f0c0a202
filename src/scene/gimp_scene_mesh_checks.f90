!> Checks of scenes on unstructured meshes, as far as they can be made before the mesh is read
module gimp_scene_mesh_checks
  use gimp_common_kinds, only: dp
  use gimp_text, only: text_of, lower, word_in
  use gimp_scene_mistakes, only: mistakes_t, or_list
  use gimp_scene_store, only: scene_t, count_groups, usable, line_of, note_key, real_of, integer_of, word_of, text_of_key
  implicit none(type, external)
  private
  public :: check_mesh, check_mesh_sides

  character(len=*), parameter :: bases = "linear cpdi cpdi2 gauss_gimp ddmp" !! shape functions that any element can have

contains

  !> The file, and what only the cells of a grid can do
  subroutine check_mesh(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    logical :: exists
    if (count_groups(scene, "mesh") == 0) return
    if (usable(scene, "mesh", 1, "file")) then
      inquire (file=text_of_key(scene, "mesh", 1, "file"), exist=exists)
      if (.not. exists) call note_key(mistakes, scene, "mesh", 1, "file", "there is no such file")
    end if
    if (usable(scene, "method", 1, "basis")) then
      if (word_in(word_of(scene, "method", 1, "basis"), bases) == 0) &
        call note_key(mistakes, scene, "method", 1, "basis", "is for the equal cells of a &grid; on a &mesh "//or_list(bases)//" is wanted")
    end if
    call refuse_word("method", "transfer", "mls", "is for the equal splines of a &grid; on a &mesh there is flip, pic, apic, tpic, xpic or fmpm")
    call refuse_words("method", "anti_locking", "averages over the cells of a &grid; there is none on a &mesh")
    if (integer_of(scene, "method", 1, "null_space_filter") > 0) &
      call note_key(mistakes, scene, "method", 1, "null_space_filter", "works on the cells of a &grid; on a &mesh it must be 0")
    if (real_of(scene, "method", 1, "redistribute_mass") > 0.0_dp) &
      call note_key(mistakes, scene, "method", 1, "redistribute_mass", "knows the full nodes of a &grid only; on a &mesh it must be 0")
    call refuse_word("method", "kernel", "list", "walks the cells of a &grid; on a &mesh auto is wanted")
    call refuse_words("time", "stability_check", "knows the cells of a &grid only; on a &mesh it must be none")

  contains

    subroutine refuse_word(group, key, word, what)
      character(len=*), intent(in) :: group, key, word, what
      if (word_of(scene, group, 1, key) == word) call note_key(mistakes, scene, group, 1, key, what)
    end subroutine refuse_word

    !> Any word but none
    subroutine refuse_words(group, key, what)
      character(len=*), intent(in) :: group, key, what
      if (usable(scene, group, 1, key) .and. word_of(scene, group, 1, key) /= "none") &
        call note_key(mistakes, scene, group, 1, key, what)
    end subroutine refuse_words

  end subroutine check_mesh

  !> One condition per name, and none that joins two sides; whether the mesh has the name shows when it is read
  pure subroutine check_mesh_sides(scene, mistakes)
    type(scene_t), intent(in) :: scene
    type(mistakes_t), intent(inout) :: mistakes
    character(len=:), allocatable :: name, other
    integer :: b, before
    do b = 1, count_groups(scene, "boundary")
      if (usable(scene, "boundary", b, "condition")) then
        if (word_of(scene, "boundary", b, "condition") == "periodic") call note_key(mistakes, scene, "boundary", b, "condition", &
          "joins sides of a &grid; the sides of a &mesh can be stick, slip, symmetry, velocity or free")
      end if
      if (.not. usable(scene, "boundary", b, "side")) cycle
      name = text_of_key(scene, "boundary", b, "side")
      do before = 1, b - 1
        if (.not. usable(scene, "boundary", before, "side")) cycle
        other = text_of_key(scene, "boundary", before, "side")
        if (name /= other .and. lower(name) /= "all" .and. lower(other) /= "all") cycle
        call note_key(mistakes, scene, "boundary", b, "side", "this side has a condition already, from line "// &
                      text_of(line_of(scene, "boundary", before, "side")))
        exit
      end do
    end do
  end subroutine check_mesh_sides

end module gimp_scene_mesh_checks
