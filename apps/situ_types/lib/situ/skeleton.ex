defmodule Situ.Skeleton do
  @moduledoc """
  A body or a hand: named joints with poses and confidences, and the bones that connect them.

      iex> joints = %{head: Situ.Pose.new({0.0, 0.0, 1.7}), neck: Situ.Pose.new({0.0, 0.0, 1.5})}
      iex> body = Situ.Skeleton.new!(joints, [{:head, :neck}])
      iex> Situ.Skeleton.joint_position(body, :head)
      {0.0, 0.0, 1.7}
      iex> {:error, error} = Situ.Skeleton.new(%{}, [{:head, :neck}])
      iex> error.code
      :bad_skeleton
  """
  alias Situ.{Error, Pose, Vector3}

  @enforce_keys [:joints, :bones]
  defstruct [:joints, :bones, id: nil, confidence: %{}]

  @type joint :: atom() | String.t()
  @type t :: %__MODULE__{
          joints: %{joint() => Pose.t()},
          bones: [{joint(), joint()}],
          id: term(),
          confidence: %{joint() => float()}
        }

  @schema [
    id: [type: :any, default: nil, doc: "The identity of the body over time."],
    confidence: [
      type: :map,
      default: %{},
      doc: "Confidence by joint, 0..1; 1 for joints that are not listed."
    ]
  ]

  @doc """
  Builds a skeleton. Each bone must connect two joints in `joints`.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(%{joint() => Pose.t()}, [{joint(), joint()}], keyword()) ::
          {:ok, t()} | {:error, Error.t()}
  def new(joints, bones, opts \\ []) when is_map(joints) and is_list(bones) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         nil <-
           Enum.find(bones, fn {a, b} -> not (is_map_key(joints, a) and is_map_key(joints, b)) end) do
      {:ok, struct!(__MODULE__, [joints: joints, bones: bones] ++ opts)}
    else
      {:error, _} = error ->
        error

      bone ->
        {:error, Error.new(:bad_skeleton, "the bone #{inspect(bone)} refers to a missing joint")}
    end
  end

  @doc "Like `new/3`, but returns the skeleton or raises the error."
  @spec new!(%{joint() => Pose.t()}, [{joint(), joint()}], keyword()) :: t()
  def new!(joints, bones, opts \\ []), do: joints |> new(bones, opts) |> Error.unwrap!()

  @doc "Returns the position of a joint, or `nil` if the joint does not exist."
  @spec joint_position(t(), joint()) :: Vector3.t() | nil
  def joint_position(%__MODULE__{joints: joints}, joint) do
    with %Pose{position: position} <- joints[joint], do: position
  end

  @doc "Transforms the skeleton from the pose's local frame to the frame in which the pose is given."
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{} = skeleton, %Pose{} = pose),
    do: %{
      skeleton
      | joints:
          Map.new(skeleton.joints, fn {name, joint} -> {name, Pose.compose(pose, joint)} end)
    }

  @doc """
  Interpolates between `a` (ratio 0) and `b` (ratio 1). The result has the joints that both have, each interpolated
  with `Situ.Pose.interpolate/3`. Returns `nil` if either is `nil`.
  """
  @spec interpolate(t() | nil, t() | nil, number()) :: t() | nil
  def interpolate(%__MODULE__{} = a, %__MODULE__{} = b, ratio) do
    joints =
      for {name, pose} <- a.joints,
          other = b.joints[name],
          into: %{},
          do: {name, Pose.interpolate(pose, other, ratio)}

    bones =
      Enum.filter(a.bones, fn {from, to} ->
        is_map_key(joints, from) and is_map_key(joints, to)
      end)

    %{a | joints: joints, bones: bones}
  end

  def interpolate(_a, _b, _ratio), do: nil
end
