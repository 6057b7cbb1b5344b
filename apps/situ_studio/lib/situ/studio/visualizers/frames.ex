defmodule Situ.Studio.Visualizers.Frames do
  @moduledoc false
  # Draws a tree of frames of reference, and gives the panel's other layers, which may be in one
  # of these frames, the pose of each frame in its root. The panel is drawn in the frame `fixed`,
  # or in the first root.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Space.FrameTree
  alias Situ.Studio.{Frame, Visualizer, StreamReader}
  alias Situ.Studio.Draw.WindowMessages
  alias Situ.Studio.Visualizers.SharedOptions

  @second 1_000_000_000
  @window 10 * @second
  @first 5_000

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        [
          fixed: [type: :text, title: "Fixed frame", auto: "the root"],
          axis: [type: {:range, 0.01, 10}, title: "Axes, m", default: 0.3],
          thickness: [type: {:range, 1, 500}, title: "Thickness, mm", default: 15],
          labels: [type: :boolean, title: "Labels", default: true]
        ]

    %Visualizer{
      id: "frames",
      title: "Frames of reference",
      panel: :space,
      shapes: [:frames],
      options: options
    }
  end

  @impl true
  def instant(channel, _data, message, %{source: source, spec: spec}) do
    time = message.originating_time

    with {:ok, frames} <- read_frames(source, spec.stream, time),
         do: Frame.json(channel, time, frame_tree(frames, time)),
         else: ({:error, error} -> {:error, error.what})
  end

  # Transforms that are always valid are usually sent only once, at the beginning.
  defp read_frames(source, stream, time) do
    with {:ok, first, _} <- StreamReader.read_messages(source, stream, 0, time, @first),
         {:ok, near, _} <-
           WindowMessages.fetch_within(source, stream, time - @window, time + @second) do
      known = Enum.filter(first, &(&1.originating_time < time - @window))

      Enum.reduce_while(known ++ near, {:ok, FrameTree.new(keep: 4 * @window)}, fn m,
                                                                                   {:ok, frames} ->
        case FrameTree.put_transforms(frames, message_transforms(m.data), m.originating_time) do
          {:ok, frames} -> {:cont, {:ok, frames}}
          error -> {:halt, error}
        end
      end)
    end
  end

  defp message_transforms(%Situ.Transform{} = one), do: [one]

  defp message_transforms(list) when is_list(list),
    do: Enum.filter(list, &is_struct(&1, Situ.Transform))

  defp message_transforms(_), do: []

  @doc """
  Returns every frame with its parent, its root and the matrix (column by column) that transforms it to the root. A
  frame whose transform is unknown at that time has a problem instead of a matrix.

      iex> alias Situ.Space.FrameTree
      iex> {:ok, frames} = FrameTree.put_static(FrameTree.new(), "lamp", "room", Situ.Pose.new({0.0, 0.0, 2.0}))
      iex> %{"frames" => %{"lamp" => lamp, "room" => _}} = Situ.Studio.Visualizers.Frames.frame_tree(frames, 0)
      iex> {lamp["root"], Enum.slice(lamp["matrix"], 12, 3)}
      {"room", [0.0, 0.0, 2.0]}
  """
  @spec frame_tree(FrameTree.t(), Situ.Time.t()) :: map()
  def frame_tree(frames, time) do
    parents = Map.new(FrameTree.list(frames), fn {frame, parent, _} -> {frame, parent} end)
    names = Enum.uniq(Map.keys(parents) ++ Map.values(parents))

    rows =
      for name <- names, into: %{} do
        root = root_frame(name, parents)
        row = %{"root" => root, "parent" => parents[name]}

        case FrameTree.lookup(frames, name, root, time) do
          {:ok, pose} -> {name, Map.put(row, "matrix", column_major(pose))}
          {:error, error} -> {name, Map.put(row, "problem", error.what)}
        end
      end

    %{"frames" => rows}
  end

  # The recursion ends, because `Situ.Space.FrameTree` rejects cycles.
  defp root_frame(name, parents),
    do: if(parents[name], do: root_frame(parents[name], parents), else: name)

  defp column_major(pose) do
    [a, b, c, x, d, e, f, y, g, h, i, z | _] = Situ.Pose.to_matrix(pose)
    [a, d, g, 0.0, b, e, h, 0.0, c, f, i, 0.0, x, y, z, 1.0]
  end
end
