defmodule Situ.Transform do
  @moduledoc """
  The pose of one frame of reference in another. Frame streams carry one transform, or a list of them, per message.

  `pose` maps coordinates in `frame` to coordinates in `parent`. A static transform is valid at all times; other
  transforms are valid at the originating time of their message.

      iex> Situ.Transform.new("camera", "robot", Situ.Pose.new({0.2, 0.0, 1.1})).static
      false
  """
  alias Situ.Pose

  @enforce_keys [:frame, :parent, :pose]
  defstruct [:frame, :parent, :pose, static: false]

  @type t :: %__MODULE__{
          frame: String.t(),
          parent: String.t(),
          pose: Pose.t(),
          static: boolean()
        }

  @schema [static: [type: :boolean, default: false, doc: "Whether it is always valid."]]

  @doc """
  Builds the transform from `frame` to `parent`.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(String.t(), String.t(), Pose.t(), keyword()) :: t()
  def new(frame, parent, %Pose{} = pose, opts \\ [])
      when is_binary(frame) and is_binary(parent) do
    opts = Situ.Options.validate!(opts, @schema)
    %__MODULE__{frame: frame, parent: parent, pose: pose, static: opts[:static]}
  end
end
