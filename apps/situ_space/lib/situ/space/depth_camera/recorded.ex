defmodule Situ.Space.DepthCamera.Recorded do
  @schema [
    path: [type: :string, required: true, doc: "The recording."],
    depth: [type: :string, default: "Depth", doc: "The stream of views with depth."],
    color: [
      type: {:optional, :string},
      default: "Color",
      doc: "The stream of views in colour; `nil` has none."
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

  Its streams hold `Situ.CameraView`s as another camera gave them. Pictures that were encoded before they were recorded
  stay so.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  @behaviour Situ.Space.DepthCamera
  alias Situ.{CameraView, Store}
  alias Situ.Space.DepthCamera

  @impl true
  def open(p, opts) do
    opts = Situ.Options.validate!(opts, @schema)
    store = Store.importer(p, opts[:path])

    %DepthCamera{
      depth: Store.stream(store, opts[:depth], type: CameraView),
      color: opts[:color] && Store.stream(store, opts[:color], type: CameraView),
      others: Map.new(opts[:others], fn {name, stream} -> {name, Store.stream(store, stream)} end)
    }
  end
end
