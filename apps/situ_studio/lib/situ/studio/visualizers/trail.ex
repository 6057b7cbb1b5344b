defmodule Situ.Studio.Visualizers.Trail do
  @moduledoc false
  # Draws the past positions of objects in space: the points of every message in the last seconds
  # before the cursor, and a line through the first point of each message.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValuePath, Scene, Visualizer, StreamReader}
  alias Situ.Studio.Draw.WindowMessages
  alias Situ.Studio.Visualizers.SharedOptions

  @second 1_000_000_000
  @most 2_000

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        SharedOptions.color() ++
        [
          frame: [type: :text, title: "In the frame", auto: "the fixed frame"],
          seconds: [type: {:range, 0.1, 3_600}, title: "Seconds", default: 5],
          thickness: [type: {:range, 1, 500}, title: "Thickness, mm", default: 8],
          point_size: [type: {:range, 0.5, 40}, title: "Point size, px", default: 4],
          opacity: [type: {:range, 0, 100}, title: "Opacity, %", default: 100]
        ]

    %Visualizer{
      id: "trail",
      title: "Trail in space",
      panel: :space,
      shapes: [:space],
      options: options
    }
  end

  @impl true
  def instant(channel, _data, message, %{source: source, spec: spec}) do
    to = message.originating_time

    from =
      to -
        round(Visualizer.property_values(spec.viz, Map.get(spec, :props, %{})).seconds * @second)

    with {:ok, messages} <- read_messages(source, spec.stream, from, to) do
      ways = messages |> Enum.map(&message_positions(&1, spec.path)) |> Enum.reject(&(&1 == []))

      cond do
        ways != [] -> Frame.scene(channel, to, trail_items(ways), [])
        all_empty?(messages, spec.path) -> Frame.scene(channel, to, [], [])
        true -> {:error, "these messages do not contain positions"}
      end
    else
      {:error, error} -> {:error, error.what}
    end
  end

  defp read_messages(source, stream, from, to) do
    case WindowMessages.fetch_within(source, stream, from, to) do
      {:ok, messages, _} when length(messages) <= @most ->
        {:ok, messages}

      {:ok, _, _} ->
        with {:ok, rows} <- StreamReader.sample_messages(source, stream, from, to, @most),
             do: {:ok, Enum.map(rows, &elem(&1, 1))}

      error ->
        error
    end
  end

  defp all_empty?(messages, path) do
    Enum.all?(messages, fn %{data: data} ->
      match?({:ok, _}, ValuePath.fetch(data, path)) and
        data |> ValuePath.fetch(path) |> elem(1) |> Scene.TermItems.empty_term?()
    end)
  end

  @doc """
  Returns the positions in a message, in order.

      iex> message = %Situ.Message{data: Situ.Pose.new({1.0, 2.0, 3.0}), originating_time: 0}
      iex> Situ.Studio.Visualizers.Trail.message_positions(message, [])
      [{1.0, 2.0, 3.0}]
  """
  @spec message_positions(Situ.Message.t(), ValuePath.t()) :: [Situ.Vector3.t()]
  def message_positions(%{data: data}, path) do
    case ValuePath.fetch(data, path) do
      {:ok, data} -> data |> term_positions() |> Enum.take(200)
      :error -> []
    end
  end

  defp term_positions(%Situ.Pose{position: p}), do: [p]
  defp term_positions(%Situ.Point3{x: x, y: y, z: z}), do: [{x, y, z}]
  defp term_positions(%Situ.Ray3{origin: p}), do: [p]
  defp term_positions(%Situ.Velocity3{origin: p}), do: [p]
  defp term_positions(%Situ.PoseVelocity{pose: pose}), do: term_positions(pose)
  defp term_positions(%Situ.Line3{from: from, to: to}), do: [from, to]
  defp term_positions(%Situ.Rectangle3{pose: pose}), do: term_positions(pose)
  defp term_positions(%Situ.Box3{} = box), do: [Situ.Box3.center_point(box)]
  defp term_positions(%Situ.CameraView{pose: pose}), do: term_positions(pose)

  defp term_positions(%Situ.Skeleton{joints: joints}),
    do: joints |> Enum.sort() |> Enum.flat_map(&term_positions(elem(&1, 1)))

  defp term_positions(list) when is_list(list),
    do: if(List.improper?(list), do: [], else: Enum.flat_map(list, &term_positions/1))

  defp term_positions(tuple) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.flat_map(&term_positions/1)

  defp term_positions(%_{}), do: []

  defp term_positions(map) when is_map(map),
    do: map |> Map.values() |> Enum.flat_map(&term_positions/1)

  defp term_positions(_), do: []

  defp trail_items(ways) do
    all = Enum.concat(ways)
    firsts = Enum.map(ways, &hd/1)
    segments = Enum.zip(firsts, tl(firsts))
    ends = Enum.flat_map(segments, fn {a, b} -> Tuple.to_list(a) ++ Tuple.to_list(b) end)
    points = [position: Scene.encode_floats(Enum.flat_map(all, &Tuple.to_list/1))]

    way =
      Scene.new_item(:lines, length(segments), [position: Scene.encode_floats(ends)], %{
        "name" => "way"
      })

    [Scene.new_item(:points, length(all), points, %{"of" => length(all), "name" => "was here"})] ++
      if(segments == [], do: [], else: [way])
  end
end
