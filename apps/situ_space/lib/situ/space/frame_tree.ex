defmodule Situ.Space.FrameTree do
  @moduledoc """
  A tree of frames of reference. Each frame has a static or moving pose in its parent, and the pose of a frame in
  another frame can be looked up at any originating time.

  Moving frames keep the poses of the last `keep` ns, and poses between them are interpolated
  (`Situ.Pose.interpolate/3`). The result does not depend on the order of arrival, because a time outside the known
  range is an error.

      iex> alias Situ.Space.FrameTree
      iex> {:ok, frames} = FrameTree.put_static(FrameTree.new(), "base", "world", Situ.Pose.new({1.0, 0.0, 0.0}))
      iex> {:ok, frames} = FrameTree.put_moving(frames, "camera", "base", 0, Situ.Pose.new({0.0, 0.0, 0.0}))
      iex> {:ok, frames} = FrameTree.put_moving(frames, "camera", "base", 100, Situ.Pose.new({0.0, 0.0, 2.0}))
      iex> {:ok, pose} = FrameTree.lookup(frames, "camera", "world", 50)
      iex> pose.position
      {1.0, 0.0, 1.0}
      iex> {:error, error} = FrameTree.lookup(frames, "camera", "world", 200)
      iex> error.what
      "the pose of \\"camera\\" in \\"base\\" is not known at 200 ns"
  """
  alias Situ.{Error, Pose}
  alias Situ.Space.PoseHistory

  defstruct frames: %{}, keep: 10_000_000_000

  @type name :: String.t()
  @typep frame :: {parent :: name(), {:static, Pose.t()} | {:moving, PoseHistory.t()}}
  @opaque t :: %__MODULE__{frames: %{name() => frame()}, keep: Situ.Time.duration()}

  @schema [
    keep: [
      type: :pos_integer,
      default: 10_000_000_000,
      doc: "How long poses of moving frames are kept, ns."
    ]
  ]

  @doc """
  Returns an empty tree.

  #{Situ.Options.docs(@schema)}
  """
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, Situ.Options.validate!(opts, @schema))

  @doc "Fixes `frame` at a pose in `parent`, for all times."
  @spec put_static(t(), name(), name(), Pose.t()) :: {:ok, t()} | {:error, Error.t()}
  def put_static(%__MODULE__{} = frames, frame, parent, %Pose{} = pose) do
    with :ok <- check_frame(frames, frame, parent, :static),
         do: {:ok, %{frames | frames: Map.put(frames.frames, frame, {parent, {:static, pose}})}}
  end

  @doc "Adds the pose of `frame` in `parent` at an originating time. Times may come in any order."
  @spec put_moving(t(), name(), name(), Situ.Time.t(), Pose.t()) ::
          {:ok, t()} | {:error, Error.t()}
  def put_moving(%__MODULE__{} = frames, frame, parent, time, %Pose{} = pose)
      when is_integer(time) do
    with :ok <- check_frame(frames, frame, parent, :moving) do
      history = PoseHistory.put(frame_history(frames.frames[frame]), time, pose, frames.keep)
      {:ok, %{frames | frames: Map.put(frames.frames, frame, {parent, {:moving, history}})}}
    end
  end

  @doc """
  Adds a message of a stream of frames with its originating time: a `Situ.Transform`, or a list of them.

      iex> alias Situ.Space.FrameTree
      iex> transforms = [Situ.Transform.new("arm", "robot", Situ.Pose.new({0.0, 0.0, 1.0}), static: true)]
      iex> {:ok, frames} = FrameTree.put_transforms(FrameTree.new(), transforms, 0)
      iex> FrameTree.list(frames)
      [{"arm", "robot", :static}]
  """
  @spec put_transforms(t(), Situ.Transform.t() | [Situ.Transform.t()], Situ.Time.t()) ::
          {:ok, t()} | {:error, Error.t()}
  def put_transforms(frames, %Situ.Transform{} = told, time),
    do: put_transforms(frames, [told], time)

  def put_transforms(frames, told, time) when is_list(told) do
    Enum.reduce_while(told, {:ok, frames}, fn transform, {:ok, frames} ->
      case put_transform(frames, transform, time) do
        {:ok, frames} -> {:cont, {:ok, frames}}
        error -> {:halt, error}
      end
    end)
  end

  defp put_transform(frames, %Situ.Transform{static: true} = t, _time),
    do: put_static(frames, t.frame, t.parent, t.pose)

  defp put_transform(frames, %Situ.Transform{} = t, time),
    do: put_moving(frames, t.frame, t.parent, time, t.pose)

  defp frame_history({_parent, {:moving, history}}), do: history
  defp frame_history(nil), do: PoseHistory.new()

  defp check_frame(_frames, frame, frame, _kind),
    do: {:error, Error.new(:frame_cycle, "the frame #{inspect(frame)} cannot be its own parent")}

  defp check_frame(frames, frame, parent, kind) do
    case frames.frames[frame] do
      {^parent, {^kind, _}} ->
        :ok

      {^parent, {other, _}} ->
        {:error,
         Error.new(
           :frame_conflict,
           "the frame #{inspect(frame)} is #{other} and cannot become #{kind}"
         )}

      {old, _} ->
        {:error,
         Error.new(:frame_conflict, "the frame #{inspect(frame)} has the parent #{inspect(old)}",
           why: "each frame has one parent; #{inspect(parent)} would be a second one",
           fix: "remove it first with Situ.Space.FrameTree.delete/2"
         )}

      nil ->
        path = ancestor_path(frames, parent)

        if frame in path do
          circle = Enum.take_while(path, &(&1 != frame)) ++ [frame]
          names = Enum.map_join([frame | circle], " in ", &inspect/1)
          {:error, Error.new(:frame_cycle, "the frames would form a cycle: #{names}")}
        else
          :ok
        end
    end
  end

  @doc "Removes a frame. Frames below it are no longer connected to the tree above it."
  @spec delete(t(), name()) :: t()
  def delete(%__MODULE__{} = frames, frame),
    do: %{frames | frames: Map.delete(frames.frames, frame)}

  @doc "Lists every frame with its parent, sorted by name."
  @spec list(t()) :: [{name(), parent :: name(), :static | :moving}]
  def list(%__MODULE__{frames: frames}),
    do: Enum.sort(for {frame, {parent, {kind, _}}} <- frames, do: {frame, parent, kind})

  @doc """
  Returns the pose of `frame` in `reference` at an originating time: `Situ.Pose.transform_point(pose, p)` converts a
  point of `frame` to `reference`. Both must be in one tree, and every moving frame between them must be known at that
  time.
  """
  @spec lookup(t(), name(), name(), Situ.Time.t()) :: {:ok, Pose.t()} | {:error, Error.t()}
  def lookup(%__MODULE__{} = frames, frame, reference, time) when is_integer(time) do
    case compose_upward(frames.frames, frame, reference, time, nil) do
      {:ok, nil} -> {:ok, Pose.identity()}
      {:ok, pose} -> {:ok, pose}
      :no -> lookup_via_ancestor(frames, frame, reference, time)
    end
  end

  # The fast path: the reference is usually an ancestor, which needs one walk upwards and no list.
  defp compose_upward(_frames, same, same, _time, pose), do: {:ok, pose}

  defp compose_upward(frames, frame, reference, time, inner) do
    with %{^frame => {parent, known}} <- frames,
         {:ok, own} <- interpolate_at(known, time) do
      pose = if inner, do: Pose.compose(own, inner), else: own
      compose_upward(frames, parent, reference, time, pose)
    else
      _ -> :no
    end
  end

  # Combines the poses of both frames in their common ancestor, or reports why there is none.
  defp lookup_via_ancestor(frames, frame, reference, time) do
    up = ancestor_path(frames, frame)
    down = if reference in up, do: [reference], else: ancestor_path(frames, reference)

    case Enum.find(up, &(&1 in down)) do
      nil ->
        {:error, not_connected_error(frames, frame, reference)}

      common ->
        with {:ok, from} <- pose_in_ancestor(frames, frame, common, time),
             {:ok, to} <- pose_in_ancestor(frames, reference, common, time),
             do: {:ok, relative_pose(from, to)}
    end
  end

  defp relative_pose(nil, nil), do: Pose.identity()
  defp relative_pose(from, nil), do: from
  defp relative_pose(nil, to), do: Pose.invert(to)
  defp relative_pose(from, to), do: Pose.compose(Pose.invert(to), from)

  defp ancestor_path(frames, frame) do
    case frames.frames[frame] do
      {parent, _} -> [frame | ancestor_path(frames, parent)]
      nil -> [frame]
    end
  end

  # Returns the pose of a frame in one of its ancestors; nil for the frame itself.
  defp pose_in_ancestor(_frames, common, common, _time), do: {:ok, nil}

  defp pose_in_ancestor(frames, frame, common, time) do
    {parent, known} = :erlang.map_get(frame, frames.frames)

    with {:ok, own} <- fetch_pose_at(known, time, frame, parent),
         {:ok, outer} <- pose_in_ancestor(frames, parent, common, time),
         do: {:ok, if(outer, do: Pose.compose(outer, own), else: own)}
  end

  defp fetch_pose_at(known, time, frame, parent) do
    with :outside <- interpolate_at(known, time) do
      {:moving, history} = known
      {:error, unknown_time_error(PoseHistory.time_span(history), time, frame, parent)}
    end
  end

  defp interpolate_at({:static, pose}, _time), do: {:ok, pose}

  defp interpolate_at({:moving, history}, time) do
    case PoseHistory.lookup_around(history, time) do
      {:exact, pose} -> {:ok, pose}
      {:between, {t0, a}, {t1, b}} -> {:ok, Pose.interpolate(a, b, (time - t0) / (t1 - t0))}
      :outside -> :outside
    end
  end

  defp unknown_time_error({first, last}, time, frame, parent) do
    Error.new(
      :frame_unknown_at,
      "the pose of #{inspect(frame)} in #{inspect(parent)} is not known at #{time} ns",
      why: "its known poses are from #{first} to #{last} ns",
      fix: "use a time in this range, wait for later poses, or keep more with keep:"
    )
  end

  defp not_connected_error(frames, frame, reference) do
    {top, other} =
      {List.last(ancestor_path(frames, frame)), List.last(ancestor_path(frames, reference))}

    Error.new(
      :frame_not_connected,
      "the frame #{inspect(frame)} is not connected to #{inspect(reference)}",
      why: "the root of the first is #{inspect(top)}, the root of the second #{inspect(other)}",
      fix: "add the pose of one root in a frame of the other tree"
    )
  end
end
