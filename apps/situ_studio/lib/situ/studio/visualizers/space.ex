defmodule Situ.Studio.Visualizers.Space do
  @moduledoc false
  # Draws objects in three dimensions: point clouds, meshes, boxes, poses, rays, skeletons, and
  # cameras with their images (`Situ.Studio.Scene.TermItems`).
  #
  # A cloud with more points than "Maximum points" is first sent thinned. When the view stops
  # moving, the page sends another request with the property `within`: the planes around the
  # visible part of the scene, as a list of four numbers each. The reply contains only clouds,
  # with as many points of that part as the limit allows.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Scene, Visualizer}
  alias Situ.Studio.Visualizers.SharedOptions

  @colors [
    {"auto", "its own, or by height"},
    {"one", "one colour"},
    {"x", "x"},
    {"y", "y"},
    {"z", "height"},
    {"distance", "distance from the origin"},
    {"value", "its value"}
  ]
  @budgets [
    {"100000", "100,000"},
    {"1000000", "1 million"},
    {"3000000", "3 million"},
    {"10000000", "10 million"}
  ]
  @texts [{"viewer", "facing the viewer"}, {"plane", "in their plane"}]
  @depths [{"points", "points"}, {"surface", "a surface"}, {"picture", "an image"}]

  @impl true
  def about do
    fixed = {:range, "fixed"}

    options =
      SharedOptions.visible() ++
        SharedOptions.color() ++
        [
          frame: [type: :text, title: "In the frame", auto: "the fixed frame"],
          color_by: [type: {:in, @colors}, title: "Colours", default: "auto"],
          range: [type: {:in, ["auto", "fixed"]}, title: "Range", default: "auto"],
          low: [type: {:range, -1.0e6, 1.0e6}, title: "from", default: 0, only: fixed],
          high: [type: {:range, -1.0e6, 1.0e6}, title: "to", default: 3, only: fixed],
          scale: [type: :boolean, title: "Colour scale", default: true],
          point_size: [type: {:range, 0.5, 40}, title: "Point size, px", default: 2],
          point_mm: [type: {:range, 0, 10_000}, title: "and at least, mm", default: 0],
          thickness: [type: {:range, 1, 500}, title: "Thickness, mm", default: 15],
          opacity: [type: {:range, 0, 100}, title: "Opacity, %", default: 100],
          plane: [type: {:range, 0.05, 100}, title: "Image plane at, m", default: 1],
          labels: [type: :boolean, title: "Labels", default: true],
          text_as: [type: {:in, @texts}, title: "Texts", default: "viewer"],
          text_height: [
            type: {:range, 0.01, 10},
            title: "Height of texts, m",
            default: 0.5,
            only: {:text_as, "plane"}
          ],
          over: [type: :boolean, title: "Draw on top", default: false],
          depth_as: [type: {:in, @depths}, title: "Depth as", default: "points"],
          sparsity: [type: {:range, 1, 50}, title: "Every n-th pixel of depth", default: 1]
        ] ++
        SharedOptions.depth_range(:depth_range,
          title: "Range of depth",
          only: {:depth_as, "picture"}
        ) ++
        [
          focal: [
            type: {:range, 1, 20_000},
            title: "Focal length of images without a lens, px",
            default: 500
          ],
          budget: [type: {:in, @budgets}, title: "Maximum points", default: "1000000"],
          axis: [type: {:range, 0.01, 10}, title: "Axes, m", default: 0.2],
          ray: [type: {:range, 0.01, 100}, title: "Rays, m", default: 1],
          threshold: [type: {:range, -1.0e9, 1.0e9}, title: "Voxels above", default: 0]
        ]

    %Visualizer{id: "space", title: "In space", panel: :space, shapes: [:space], options: options}
  end

  @impl true
  def instant(channel, data, message, %{spec: spec} = context) do
    case Scene.TermItems.collect_items(data, scene_settings(spec)) do
      {[], []} ->
        if Scene.TermItems.empty_term?(data),
          do: Frame.scene(channel, message.originating_time, [], []),
          else: {:error, "this message does not contain anything in space"}

      {[], [what | _]} ->
        {:error, what}

      {items, problems} ->
        {items, kept} = Scene.cache_meshes(items, context[:kept])
        {:kept, Frame.scene(channel, message.originating_time, items, problems), kept}
    end
  end

  @doc "Builds the settings for collecting a message's items, from the properties."
  @spec scene_settings(Visualizer.spec()) :: Scene.TermItems.settings()
  def scene_settings(%{viz: viz} = spec) do
    props = Map.get(spec, :props, %{})
    s = Visualizer.property_values(viz, props)

    %{
      within: parse_planes(props["within"]),
      budget: String.to_integer(s.budget),
      depth_as: s.depth_as,
      sparsity: round(s.sparsity),
      focal: s.focal,
      text: if(s.text_as == "plane", do: s.text_height),
      axis: s.axis,
      ray: s.ray,
      threshold: s.threshold
    }
  end

  # Parses the planes around the visible part of a scene, four numbers each.
  defp parse_planes(numbers) when is_list(numbers) and length(numbers) <= 32 do
    if rem(length(numbers), 4) == 0 and
         Enum.all?(numbers, &(is_number(&1) and abs(&1) < 1.0e30)),
       do: numbers |> Enum.chunk_every(4) |> Enum.map(&List.to_tuple/1)
  end

  defp parse_planes(_other), do: nil
end
