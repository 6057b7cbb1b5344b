defmodule Situ.Space.DepthCamera.Recorded do
  @schema [
    path: [type: :string, required: true, doc: "The recording."],
    depth: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The stream of views with depth, or of pictures of depth; by default `\"Depth\"`, or that of a RealSense bag."
    ],
    color: [
      type: {:optional, :string},
      default: nil,
      doc: "The stream of views in colour; by default `\"Color\"` where there is one."
    ],
    lens: [
      type: {:optional, :string},
      default: nil,
      doc:
        "For pictures of depth: the stream that tells their intrinsics; by default the one of a RealSense bag."
    ],
    intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "For pictures of depth: the intrinsics themselves."
    ],
    pose: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc:
        "For pictures of depth: where the camera stood; by default it is the frame of what it sees."
    ],
    others: [
      type: {:list, :any},
      default: [],
      doc: "Streams beside them, as `[bodies: \"Bodies\"]`."
    ]
  ]

  @moduledoc """
  A depth camera that replays a recording of one.

      room = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Recorded, path: "recordings/room.0000"})
      d435 = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Recorded, path: "d435.bag"})

  Its streams hold `Situ.CameraView`s as another camera gave them. Pictures that were encoded before they were recorded
  stay so. Recordings of plain pictures of depth become views by their intrinsics: of bags that the RealSense SDK or its
  viewer wrote those of the file, of others `lens:` or `intrinsics:`. A RealSense camera's colour has another place than
  its depth, which is not read: it is a stream of pictures, not of views.

  Raises `Situ.Error`: `:no_such_stream`, and `:no_intrinsics` where those of pictures of depth are not known.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  @behaviour Situ.Space.DepthCamera
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Error, Pose, Store}
  alias Situ.Space.DepthCamera

  @real_sense ~r"\A(/device_\d+/sensor_\d+/Depth_\d+)/image/data\z"

  @impl true
  def open(p, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    recording = Store.open!(opts[:path])
    names = for info <- Store.streams(recording), do: info.name
    depth = depth!(names, opts)
    color = opts[:color] || Enum.find(names, &(&1 == "Color"))
    store = Store.importer(p, opts[:path])

    %DepthCamera{
      depth: views(recording, store, depth, opts),
      color: color && Store.stream(store, color, type: CameraView),
      others: Map.new(opts[:others], fn {name, stream} -> {name, Store.stream(store, stream)} end)
    }
  end

  defp depth!(names, opts) do
    wanted = opts[:depth] || "Depth"
    real_sense = if opts[:depth] == nil, do: Enum.find(names, &(&1 =~ @real_sense))

    cond do
      wanted in names ->
        wanted

      real_sense ->
        real_sense

      true ->
        raise Error.new(:no_such_stream, "#{opts[:path]} has no stream #{inspect(wanted)}",
                why: "it has #{names |> Enum.take(8) |> Enum.join(", ")}",
                fix: "name the stream of depth by `depth:`"
              )
    end
  end

  # Views as they are; pictures become some.
  defp views(recording, store, depth, opts) do
    case first(recording, depth) do
      %DepthImage{} ->
        lens = lens!(recording, depth, opts)
        pose = opts[:pose] || Pose.identity()

        store
        |> Store.stream(depth)
        |> Situ.map(&view(&1, lens, pose), name: "Views", type: CameraView)

      _views_or_nothing ->
        Store.stream(store, depth, type: CameraView)
    end
  end

  defp view(%DepthImage{} = depth, lens, pose), do: CameraView.new(depth, lens, pose)

  defp view(other, _lens, _pose) do
    raise Error.new(
            :wrong_data,
            "not a picture of depth: #{inspect(other, limit: 5, printable_limit: 80)}",
            why: "the first message of the stream is one"
          )
  end

  defp first(recording, stream),
    do: recording |> Store.messages(stream) |> Enum.find_value(& &1.data)

  defp lens!(recording, depth, opts) do
    opts[:intrinsics] || told!(recording, opts[:lens] || beside(depth), depth)
  end

  defp beside(depth) do
    case Regex.run(@real_sense, depth) do
      [_, stream] -> stream <> "/info/camera_info"
      nil -> nil
    end
  end

  defp told!(recording, lens, depth) do
    known? = lens != nil and Enum.any?(Store.streams(recording), &(&1.name == lens))

    case known? && first(recording, lens) do
      %CameraIntrinsics{} = intrinsics ->
        intrinsics

      other ->
        why =
          cond do
            lens == nil -> "no stream of the recording is known to tell them"
            not known? -> "there is no stream #{inspect(lens)}"
            true -> "#{lens} has #{inspect(other, limit: 5, printable_limit: 80)}, which are none"
          end

        raise Error.new(:no_intrinsics, "the intrinsics of #{depth} are not known",
                why: why,
                fix: "name the stream that tells them by `lens:`, or give them by `intrinsics:`"
              )
    end
  end
end
