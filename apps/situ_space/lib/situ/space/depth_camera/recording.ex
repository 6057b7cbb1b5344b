defmodule Situ.Space.DepthCamera.Recording do
  @moduledoc """
  A depth camera that replays the recording of one.

      room = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Recording, path: "recordings/room.0000"})
      d435 = Situ.Space.DepthCamera.open(p, {Situ.Space.DepthCamera.Recording, path: "d435.bag"})

  Its streams contain the `Situ.CameraView`s of the recorded camera. Images that were encoded before recording stay
  encoded. Depth images without views become views by adding intrinsics. Bags of the RealSense SDK or its viewer
  contain the intrinsics; other recordings need `lens:` or `intrinsics:`. The colour sensor of a RealSense camera has
  a different pose than its depth sensor, and that pose is not read. Its colour stream therefore contains images, not
  views.

  Raises `Situ.Error`: `:no_such_stream`, and `:no_intrinsics` if the intrinsics of depth images are not known.
  """

  @schema [
    path: [type: :string, required: true, doc: "The path of the recording."],
    depth: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The stream of depth views or depth images; by default `\"Depth\"`, or the depth stream of a RealSense bag."
    ],
    color: [
      type: {:optional, :string},
      default: nil,
      doc: "The stream of colour views; by default `\"Color\"` if it exists."
    ],
    lens: [
      type: {:optional, :string},
      default: nil,
      doc:
        "For depth images: the stream with their intrinsics; by default the one in a RealSense bag."
    ],
    intrinsics: [
      type: {:optional, {:struct, Situ.CameraIntrinsics}},
      default: nil,
      doc: "For depth images: the intrinsics themselves."
    ],
    pose: [
      type: {:optional, {:struct, Situ.Pose}},
      default: nil,
      doc:
        "For depth images: the camera's pose; by default the identity, so points are in the camera's frame."
    ],
    others: [
      type: {:list, :any},
      default: [],
      doc: "Additional streams, for example `[bodies: \"Bodies\"]`."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @behaviour Situ.Space.DepthCamera
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Error, Pose, Store}
  alias Situ.Space.DepthCamera

  @real_sense ~r"\A(/device_\d+/sensor_\d+/Depth_\d+)/image/data\z"

  @impl true
  def open(p, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    recording = Store.open!(opts[:path])
    names = for info <- Store.streams(recording), do: info.name
    depth = find_depth_stream!(names, opts)
    color = opts[:color] || Enum.find(names, &(&1 == "Color"))
    store = Store.importer(p, opts[:path])

    %DepthCamera{
      depth: depth_views(recording, store, depth, opts),
      color: color && Store.stream(store, color, type: CameraView),
      others: Map.new(opts[:others], fn {name, stream} -> {name, Store.stream(store, stream)} end)
    }
  end

  defp find_depth_stream!(names, opts) do
    wanted = opts[:depth] || "Depth"
    real_sense = if opts[:depth] == nil, do: Enum.find(names, &(&1 =~ @real_sense))

    cond do
      wanted in names ->
        wanted

      real_sense ->
        real_sense

      true ->
        raise Error.new(:no_such_stream, "#{opts[:path]} has no stream #{inspect(wanted)}",
                why: "its streams are #{names |> Enum.take(8) |> Enum.join(", ")}",
                fix: "name the depth stream with `depth:`"
              )
    end
  end

  # Views are used unchanged; depth images are converted to views.
  defp depth_views(recording, store, depth, opts) do
    case first_data(recording, depth) do
      %DepthImage{} ->
        lens = resolve_lens!(recording, depth, opts)
        pose = opts[:pose] || Pose.identity()

        store
        |> Store.stream(depth)
        |> Situ.map(&build_view(&1, lens, pose), name: "Views", type: CameraView)

      _views_or_nothing ->
        Store.stream(store, depth, type: CameraView)
    end
  end

  defp build_view(%DepthImage{} = depth, lens, pose), do: CameraView.new(depth, lens, pose)

  defp build_view(other, _lens, _pose) do
    raise Error.new(
            :wrong_data,
            "expected a depth image, got #{inspect(other, limit: 5, printable_limit: 80)}",
            why: "the first message is a depth image, so all others must be depth images"
          )
  end

  defp first_data(recording, stream),
    do: recording |> Store.messages(stream) |> Enum.find_value(& &1.data)

  defp resolve_lens!(recording, depth, opts) do
    opts[:intrinsics] ||
      read_intrinsics!(recording, opts[:lens] || camera_info_stream(depth), depth)
  end

  defp camera_info_stream(depth) do
    case Regex.run(@real_sense, depth) do
      [_, stream] -> stream <> "/info/camera_info"
      nil -> nil
    end
  end

  defp read_intrinsics!(recording, lens, depth) do
    known? = lens != nil and Enum.any?(Store.streams(recording), &(&1.name == lens))

    case known? && first_data(recording, lens) do
      %CameraIntrinsics{} = intrinsics ->
        intrinsics

      other ->
        why =
          cond do
            lens == nil ->
              "no stream of the recording is known to contain them"

            not known? ->
              "the stream #{inspect(lens)} does not exist"

            true ->
              "#{lens} contains #{inspect(other, limit: 5, printable_limit: 80)} instead of intrinsics"
          end

        raise Error.new(:no_intrinsics, "the intrinsics of #{depth} are not known",
                why: why,
                fix: "name the stream that contains them with `lens:`, or set `intrinsics:`"
              )
    end
  end
end
