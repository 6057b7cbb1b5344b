defmodule Situ.Space.GeometryFile.AffineTransform do
  @moduledoc false
  # Affine transforms from files, which rotate, scale and move positions: three rows of four numbers.
  @type t :: {row(), row(), row()}
  @typep row :: {float(), float(), float(), float()}
  @typep place :: {float(), float(), float()}

  @spec identity() :: t()
  def identity, do: translation({0.0, 0.0, 0.0})

  @spec translation(place()) :: t()
  def translation({x, y, z}), do: {{1.0, 0.0, 0.0, x}, {0.0, 1.0, 0.0, y}, {0.0, 0.0, 1.0, z}}

  @spec scaling(place()) :: t()
  def scaling({x, y, z}), do: {{x, 0.0, 0.0, 0.0}, {0.0, y, 0.0, 0.0}, {0.0, 0.0, z, 0.0}}

  @doc "Builds a transform from sixteen numbers, row by row, and drops the last row."
  @spec from_rows([float()]) :: t()
  def from_rows([a, b, c, x, d, e, f, y, g, h, i, z | _]),
    do: {{a, b, c, x}, {d, e, f, y}, {g, h, i, z}}

  @doc "Builds a rotation around an axis by degrees. The axis may have any length; a zero axis yields the identity."
  @spec rotation_around(place(), float()) :: t()
  def rotation_around(axis, degrees) do
    case Situ.Vector3.normalize(axis) do
      {:ok, axis} ->
        turn = Situ.Quaternion.from_axis_angle(axis, degrees * :math.pi() / 180)
        {{a, b, c}, {d, e, f}, {g, h, i}} = Situ.Quaternion.to_matrix(turn)
        {{a, b, c, 0.0}, {d, e, f, 0.0}, {g, h, i, 0.0}}

      :error ->
        identity()
    end
  end

  @doc "Composes two transforms. The second is applied first."
  @spec compose(t(), t()) :: t()
  def compose({r0, r1, r2}, inner),
    do: {multiply_row(r0, inner), multiply_row(r1, inner), multiply_row(r2, inner)}

  defp multiply_row({a, b, c, d}, {{a0, b0, c0, d0}, {a1, b1, c1, d1}, {a2, b2, c2, d2}}),
    do:
      {a * a0 + b * a1 + c * a2, a * b0 + b * b1 + c * b2, a * c0 + b * c1 + c * c2,
       a * d0 + b * d1 + c * d2 + d}

  @spec transform_point(t(), place()) :: place()
  def transform_point({r0, r1, r2}, place),
    do: {apply_row(r0, place), apply_row(r1, place), apply_row(r2, place)}

  defp apply_row({a, b, c, d}, {x, y, z}), do: a * x + b * y + c * z + d
end
