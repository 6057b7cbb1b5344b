defmodule Situ.Space.Orientation do
  @moduledoc false
  # Estimates the orientation of an inertial sensor from its readings, one by one. `Situ.Space.orientation/2` documents
  # the method and the options.

  @schema [
    gain: [
      type: :number,
      default: 0.5,
      doc:
        "How strongly the accelerometer and the magnetometer correct the gyroscope, 1/s; 0 uses only the gyroscope."
    ],
    drift: [
      type: :number,
      default: 0.0,
      doc: "How fast the gyroscope's offset is estimated, 1/s2; 0 disables the estimate."
    ],
    magnetometer: [
      type: :boolean,
      default: true,
      doc: "Whether to use the magnetic field of readings that have one to find north."
    ],
    still: [
      type: {:optional, :number},
      default: nil,
      doc:
        "Ignore accelerations that differ from gravity by more than this fraction of it; `nil` uses all of them."
    ],
    start: [
      type: {:optional, :any},
      default: nil,
      doc:
        "The initial quaternion; by default it is computed from the first reading (heading 0 without a magnetic field)."
    ]
  ]

  alias Situ.{ImuReading, Quaternion, Vector3}

  defstruct [:opts, :time, rotation: nil, drift: {0.0, 0.0, 0.0}]

  @typedoc "`rotation` is `nil` before the first reading; `drift` is the estimated gyroscope reading at rest."
  @type t :: %__MODULE__{
          opts: map(),
          time: Situ.Time.t() | nil,
          rotation: Quaternion.t() | nil,
          drift: Vector3.t()
        }

  @gravity 9.80665
  # After a longer gap the motion in between is unknown, so the filter starts again.
  @gap 1_000_000_000

  @doc false
  def option_schema, do: @schema

  @doc """
  Builds a filter.

  #{Situ.Options.docs(@schema)}

      iex> alias Situ.Space.Orientation
      iex> level = Situ.ImuReading.new({0.0, 0.0, 9.81}, {0.0, 0.0, 0.1})
      iex> o = Enum.reduce(0..100, Orientation.new(), &Orientation.update(&2, level, &1 * 10_000_000))
      iex> {yaw, _, _} = Situ.Quaternion.to_euler(o.rotation)
      iex> Float.round(yaw, 6)
      0.1
  """
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: %__MODULE__{opts: Map.new(Situ.Options.validate!(opts, @schema))}

  @doc "Updates the filter with a reading at an originating time. After a gap of more than a second it starts again."
  @spec update(t(), ImuReading.t(), Situ.Time.t()) :: t()
  def update(%__MODULE__{time: last} = o, %ImuReading{} = reading, time)
      when last == nil or time - last > @gap,
      do: %{o | time: time, rotation: initial_rotation(reading, o.opts), drift: {0.0, 0.0, 0.0}}

  def update(%__MODULE__{} = o, %ImuReading{} = reading, time) do
    seconds = (time - o.time) / 1.0e9
    pull = correction_vector(reading, o)
    drift = Vector3.add(o.drift, Vector3.scale(pull, -o.opts.drift * seconds))

    turn =
      reading.angular_velocity
      |> Vector3.subtract(drift)
      |> Vector3.add(Vector3.scale(pull, o.opts.gain))

    {:ok, rotation} =
      o.rotation |> Quaternion.multiply(rotation_step(turn, seconds)) |> Quaternion.normalize()

    %{o | time: time, rotation: rotation, drift: drift}
  end

  defp rotation_step(turn, seconds) do
    case Vector3.normalize(turn) do
      {:ok, axis} -> Quaternion.from_axis_angle(axis, Vector3.norm(turn) * seconds)
      :error -> Quaternion.identity()
    end
  end

  # Returns the rotation (axis times sine, in the sensor's axes) between the measured directions and the estimated ones.
  defp correction_vector(reading, %{rotation: rotation, opts: opts}) do
    back = Quaternion.invert(rotation)
    up = Quaternion.rotate_vector(back, {0.0, 0.0, 1.0})

    with {:ok, measured} <- measured_up(reading, opts) do
      tilt = Vector3.cross_product(measured, up)

      case measured_west(reading, measured, opts) do
        {:ok, west} ->
          Vector3.add(
            tilt,
            Vector3.cross_product(west, Quaternion.rotate_vector(back, {0.0, 1.0, 0.0}))
          )

        :error ->
          tilt
      end
    else
      :error -> {0.0, 0.0, 0.0}
    end
  end

  defp measured_up(%{acceleration: a}, %{still: still}) do
    if still == nil or abs(Vector3.norm(a) - @gravity) <= still * @gravity,
      do: Vector3.normalize(a),
      else: :error
  end

  # The field points north and down, so the cross product of up and the field points west.
  defp measured_west(%{magnetic_field: {_, _, _} = field}, up, %{magnetometer: true}),
    do: up |> Vector3.cross_product(field) |> Vector3.normalize()

  defp measured_west(_reading, _up, _opts), do: :error

  defp initial_rotation(_reading, %{start: {_, _, _, _} = q}), do: q

  defp initial_rotation(reading, opts) do
    with {:ok, up} <- Vector3.normalize(reading.acceleration),
         {:ok, west} <- initial_west(reading, up, opts),
         north = Vector3.cross_product(west, up),
         {:ok, q} <- Quaternion.from_matrix({north, west, up}) do
      q
    else
      :error -> Quaternion.identity()
    end
  end

  defp initial_west(reading, up, opts) do
    with :error <- measured_west(reading, up, opts),
         :error <- up |> Vector3.cross_product({1.0, 0.0, 0.0}) |> Vector3.normalize(),
         do: {:ok, {0.0, 1.0, 0.0}}
  end
end
