defmodule Situ.JointState do
  @moduledoc """
  The state of a robot's joints: their names and, in the same order, positions (radians, or metres for sliding
  joints), velocities (rad/s, m/s) and efforts (N m, N). A list is empty if its values are unknown.

      iex> {:ok, arm} = Situ.JointState.new(["shoulder", "elbow"], [0.1, 1.2])
      iex> Situ.JointState.joint_position(arm, "elbow")
      1.2
      iex> {:error, error} = Situ.JointState.new(["shoulder"], [0.1, 1.2])
      iex> error.what
      "2 positions for 1 joints"
  """
  alias Situ.{Error, Number}

  @enforce_keys [:names]
  defstruct [:names, positions: [], velocities: [], efforts: []]

  @type t :: %__MODULE__{
          names: [String.t()],
          positions: [Number.t()],
          velocities: [Number.t()],
          efforts: [Number.t()]
        }

  @doc "Builds a validated state. Each list must be empty or as long as `names`. Error: `:bad_joints`."
  @spec new([String.t()], [Number.t()], [Number.t()], [Number.t()]) ::
          {:ok, t()} | {:error, Error.t()}
  def new(names, positions \\ [], velocities \\ [], efforts \\ [])
      when is_list(names) and is_list(positions) and is_list(velocities) and is_list(efforts) do
    lists = [positions: positions, velocities: velocities, efforts: efforts]

    case Enum.find(lists, fn {_, list} -> list != [] and length(list) != length(names) end) do
      nil ->
        {:ok, struct!(__MODULE__, [names: names] ++ lists)}

      {name, list} ->
        {:error, Error.new(:bad_joints, "#{length(list)} #{name} for #{length(names)} joints")}
    end
  end

  @doc "Returns the position of a joint, or `nil` if the joint or its position is unknown."
  @spec joint_position(t(), String.t()) :: Number.t() | nil
  def joint_position(%__MODULE__{names: names, positions: positions}, name) do
    case Enum.find_index(names, &(&1 == name)) do
      nil -> nil
      at -> Enum.at(positions, at)
    end
  end
end
