!> What the models on logarithmic elastic strain share: trial strain, elasticity, storage, bound of the wave speed.
!>
!> Kinematics (Simo 1992; de Souza Neto, Peric & Owen 2008, ch. 14): the elastic left Cauchy-Green tensor b_e is pushed
!> forward, b_tr = dF b_e dF^T, and the trial strain e = 1/2 ln b_tr is returned to the yield surface as at small strain.
!> Elasticity (Hencky): tau = lambda tr(e) I + 2 mu e. What is stored is e: the stress is linear in it, and b_e = exp(2 e) is
!> made anew in each step, counted from the unit tensor, so that a step's error is round-off of the strain and not of 1.
!> An isotropic return scales the deviator and shifts the mean of e, so no step needs principal axes.
module gimp_log_strain
  use gimp_kinds, only: wp, lanes
  use gimp_tensor, only: determinant
  use gimp_tensor_functions, only: push_forward_strain, half_logarithm, exponential_of_twice, strain_logarithm
  implicit none(type, external)
  private
  public :: plastic_states, at_plastic_strain, at_strain
  public :: trial_strain, starting_strain, kirchhoff_of_strain, elastic_energy, wave_bound

  !> History of the plastic models: equivalent plastic strain, then the elastic logarithmic strain
  integer, parameter :: plastic_states = 7
  integer, parameter :: at_plastic_strain = 1 !! where the equivalent plastic strain sits
  integer, parameter :: at_strain = 2 !! first of the six components of the strain

contains

  !> The strain before plastic flow
  pure subroutine trial_strain(df, old, e)
    real(wp), intent(in) :: df(lanes, 9) !! increment of the deformation gradient
    real(wp), intent(in) :: old(lanes, 6) !! elastic logarithmic strain of the old step
    real(wp), intent(out) :: e(lanes, 6) !! logarithmic trial strain
    real(wp) :: x(lanes, 6), pushed(lanes, 6)
    call exponential_of_twice(old, x)
    call push_forward_strain(df, x, pushed)
    call half_logarithm(pushed, e)
  end subroutine trial_strain

  !> The trial strain at t = 0: from F, or from the initial stress where one is given
  pure subroutine starting_strain(lambda, mu, f, stress, e)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: f(lanes, 9) !! deformation gradient at t = 0
    real(wp), intent(in) :: stress(lanes, 6) !! Cauchy stress at t = 0 [Pa]
    real(wp), intent(out) :: e(lanes, 6) !! logarithmic trial strain
    real(wp) :: j(lanes), trace
    integer :: k
    call strain_logarithm(f, e)
    call determinant(f, j)
    do k = 1, lanes
      if (.not. maxval(abs(stress(k, :))) > 0.0_wp) cycle
      trace = lambda*sum(stress(k, 1:3))/(3*lambda + 2*mu)
      e(k, 1:3) = j(k)*(stress(k, 1:3) - trace)/(2*mu)
      e(k, 4:6) = j(k)*stress(k, 4:6)/(2*mu)
    end do
  end subroutine starting_strain

  !> tau = lambda tr(e) I + 2 mu e
  pure subroutine kirchhoff_of_strain(lambda, mu, e, tau)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: e(lanes, 6) !! elastic logarithmic strain
    real(wp), intent(out) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp) :: volumetric
    integer :: k
    !$omp simd simdlen(lanes) private(volumetric)
    do k = 1, lanes
      volumetric = lambda*(e(k, 1) + e(k, 2) + e(k, 3))
      tau(k, 1) = volumetric + 2.0_wp*mu*e(k, 1)
      tau(k, 2) = volumetric + 2.0_wp*mu*e(k, 2)
      tau(k, 3) = volumetric + 2.0_wp*mu*e(k, 3)
      tau(k, 4) = 2.0_wp*mu*e(k, 4)
      tau(k, 5) = 2.0_wp*mu*e(k, 5)
      tau(k, 6) = 2.0_wp*mu*e(k, 6)
    end do
  end subroutine kirchhoff_of_strain

  !> W = mu e:e + lambda/2 tr(e)^2
  pure subroutine elastic_energy(lambda, mu, e, energy)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: e(lanes, 6) !! elastic logarithmic strain
    real(wp), intent(out) :: energy(lanes) !! per reference volume [J/m3]
    integer :: k
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      energy(k) = mu*(e(k, 1)**2 + e(k, 2)**2 + e(k, 3)**2 + 2.0_wp*(e(k, 4)**2 + e(k, 5)**2 + e(k, 6)**2)) &
        + 0.5_wp*lambda*(e(k, 1) + e(k, 2) + e(k, 3))**2
    end do
  end subroutine elastic_energy

  !> An upper bound of the squared elastic wave speed from invariants of the stress alone
  !>
  !> In principal axes the acoustic tensor of an isotropic law (Ogden 1984, ch. 6), times the current volume ratio, gives for
  !> direction n and polarisation m (both unit vectors)
  !>   m.Q m = lambda (m.n)^2 + sum_i (2 mu - t_i) m_i^2 n_i^2 + sum_{i/=j} [g_ij m_i n_i m_j n_j + s_ij m_i^2 n_j^2],
  !>   s_ij = (t_i - t_j) b_j/(b_i - b_j) = mu ln r/(r - 1), r = b_i/b_j;  g_ij = s_ij - t_j = s_ji - t_i.
  !> The numbers m_i n_j have the norm 1, so the last two sums are at most the largest of 2 mu - t_i and of the eigenvalues of
  !> the pairs, M_ij + sqrt(((t_i - t_j)/2)^2 + g_ij^2), M_ij = (s_ij + s_ji)/2 = mu (x/2) coth(x/2) with x = |ln r|, between
  !> mu and mu (1 + min(x^2/12, x/2)). With |dev t| the norm of the deviator: x <= sqrt(2) |dev t|/mu,
  !> |t_i - t_j| <= sqrt(2) |dev t|, |g_ij| <= |M_ij - p| + |dev t|/sqrt(6), |t_i - p| <= sqrt(2/3) |dev t|.
  !> Exact, lambda + 2 mu, without stress.
  pure subroutine wave_bound(lambda, mu, density, tau, speed2)
    real(wp), intent(in) :: lambda, mu !! Lame constants [Pa]
    real(wp), intent(in) :: density !! reference density [kg/m3]
    real(wp), intent(in) :: tau(lanes, 6) !! Kirchhoff stress [Pa]
    real(wp), intent(out) :: speed2(lanes) !! [m2/s2]
    real(wp), parameter :: third = 1.0_wp/3.0_wp, root_sixth = sqrt(1.0_wp/6.0_wp), root_two_thirds = sqrt(2.0_wp/3.0_wp)
    real(wp) :: per_density, per_mu ! a division in a lane loop costs as much as ten multiplications
    integer :: k
    per_density = 1.0_wp/density
    per_mu = sqrt(2.0_wp)/mu
    !$omp simd simdlen(lanes)
    do k = 1, lanes
      block
        real(wp) :: p, norm2, norm, x, mean, g
        p = third*(tau(k, 1) + tau(k, 2) + tau(k, 3))
        norm2 = (tau(k, 1) - p)**2 + (tau(k, 2) - p)**2 + (tau(k, 3) - p)**2 &
          + 2.0_wp*(tau(k, 4)**2 + tau(k, 5)**2 + tau(k, 6)**2)
        norm = sqrt(norm2)
        x = per_mu*norm
        mean = mu*(1.0_wp + min(0.25_wp*third*x*x, 0.5_wp*x))
        g = max(abs(mu - p), abs(mean - p)) + root_sixth*norm
        speed2(k) = per_density*(max(lambda, 0.0_wp) &
          + max(mean + sqrt(0.5_wp*norm2 + g*g), 2.0_wp*mu - p + root_two_thirds*norm))
      end block
    end do
  end subroutine wave_bound

end module gimp_log_strain
