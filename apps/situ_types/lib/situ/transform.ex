defmodule Situ.Transform do
  @moduledoc """
  Where one frame of reference lies in another: what a stream of frames is made of (one, or a list of them, a message).

  `pose` takes coordinates of `frame` to those of `parent`. A static one holds at all times, any other at the message's
  originating time.

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

  @schema [static: [type: :boolean, default: false, doc: "Whether it holds at all times."]]

  @doc """
  The place of `frame` in `parent`.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(String.t(), String.t(), Pose.t(), keyword()) :: t()
  def new(frame, parent, %Pose{} = pose, opts \\ [])
      when is_binary(frame) and is_binary(parent) do
    opts = Situ.Options.validate!(opts, @schema)
    %__MODULE__{frame: frame, parent: parent, pose: pose, static: opts[:static]}
  end
end
