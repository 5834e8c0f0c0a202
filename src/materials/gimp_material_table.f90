!> The one table of constitutive models: a new model is its own file, one row here, and its tests.
module gimp_material_table
  use gimp_error, only: error_t, raise
  use gimp_text, only: word_in, nth_word, count_words
  use gimp_material, only: material_t
  use gimp_material_options, only: material_options_t, real_keys, word_keys, give_real, give_word, need, refuse, unset
  use gimp_neo_hookean, only: make_neo_hookean
  use gimp_linear_elastic, only: make_linear_elastic
  use gimp_hencky, only: make_hencky
  use gimp_hencky_von_mises, only: make_hencky_von_mises
  use gimp_drucker_prager, only: make_drucker_prager
  implicit none(type, external)
  private
  public :: make_material, material_models, material_options_t, unset, real_keys, word_keys, give_real, give_word

  abstract interface
    !> Make a model from the options of a scene; the keys given have been checked against the table
    subroutine make_i(options, material, error)
      import :: material_options_t, material_t, error_t
      implicit none(type, external)
      type(material_options_t), intent(in) :: options
      class(material_t), allocatable, intent(out) :: material
      type(error_t), allocatable, intent(out) :: error
    end subroutine make_i
  end interface

  !> A model
  type :: row_t
    character(len=32) :: model = "" !! the word in the scene
    character(len=80) :: required = "" !! keys it needs beside the common ones
    character(len=80) :: optional = "" !! keys it reads if given
    procedure(make_i), pointer, nopass :: make => null()
  end type row_t

  !> Keys every model needs
  character(len=*), parameter :: common = "density young_modulus poisson_ratio"

contains

  !> The table
  subroutine list_models(rows)
    type(row_t), allocatable, intent(out) :: rows(:)
    allocate (rows(5))
    rows(1) = row_t("neo_hookean", "", "", make_neo_hookean)
    rows(2) = row_t("linear_elastic", "", "rate rate_form", make_linear_elastic)
    rows(3) = row_t("hencky", "", "", make_hencky)
    rows(4) = row_t("hencky_von_mises", "yield_stress", &
      "hardening hardening_modulus hardening_exponent hardening_strain", make_hencky_von_mises)
    rows(5) = row_t("drucker_prager", "friction_angle", "cohesion dilation_angle cone", make_drucker_prager)
  end subroutine list_models

  !> The words for `model`, with blanks between them
  function material_models() result(words)
    character(len=:), allocatable :: words
    type(row_t), allocatable :: rows(:)
    integer :: r
    call list_models(rows)
    words = trim(rows(1)%model)
    do r = 2, size(rows)
      words = words//" "//trim(rows(r)%model)
    end do
  end function material_models

  !> Make a material; every wrong, missing or meaningless key is told in one go
  subroutine make_material(options, material, error)
    type(material_options_t), intent(in) :: options
    class(material_t), allocatable, intent(out) :: material !! allocated where there is no error
    type(error_t), allocatable, intent(out) :: error
    type(row_t), allocatable :: rows(:)
    integer :: r
    call list_models(rows)
    do r = 1, size(rows)
      if (rows(r)%model /= options%model) cycle
      call check_keys(options, rows(r), error)
      if (allocated(error)) return
      call rows(r)%make(options, material, error)
      if (allocated(error) .and. allocated(material)) deallocate (material)
      return
    end do
    call raise(error, "&material """//trim(options%name)//""": model = '"//trim(options%model)//"'; must be one of: " &
      //material_models())
  end subroutine make_material

  !> Complain about keys the model needs and does not get, and about keys it has no use for
  subroutine check_keys(options, row, error)
    type(material_options_t), intent(in) :: options
    type(row_t), intent(in) :: row
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: required, known, key
    integer :: k
    required = common//" "//trim(row%required)
    do k = 1, count_words(required)
      call need(options, nth_word(required, k), "model = '"//trim(row%model)//"'", error)
    end do
    known = real_keys//" "//word_keys
    do k = 1, count_words(known)
      key = nth_word(known, k)
      if (word_in(key, required//" "//trim(row%optional)) > 0) cycle
      call refuse(options, key, "model = '"//trim(row%model)//"'", error)
    end do
  end subroutine check_keys

end module gimp_material_table
