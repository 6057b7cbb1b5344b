defmodule Situ.Studio.Headset.Display do
  @moduledoc """
  Draws the data of a stream in a headset (`Situ.Studio.Headset`): poses, rays, boxes, positioned texts, rectangles,
  images, meshes, point clouds, skeletons and everything else that a 3D panel of the studio draws.

      objects
      |> Situ.map(fn object -> {object.name, object.box} end)
      |> Situ.Studio.Headset.Display.show(as: "objects", color: "#ffcc00")

  Each message replaces the drawing of the previous one; a message with nothing to draw clears it. Positions are in the
  headset's frame (x forward, y left, z up, relative to the start of its session). A page that connects later receives
  the last message. While a drawing is in flight, only the newest later drawing is kept.
  """

  @schema [
    page: [type: :string, default: "headset", doc: "The headset's name."],
    as: [
      type: :string,
      default: "shown",
      doc: "The drawing's name. Streams shown at the same time need different names."
    ],
    color: [
      type: :string,
      default: "#4ea1ff",
      doc: "The colour (`#rrggbb`) of objects that do not have one."
    ],
    axis: [type: :number, default: 0.1, doc: "The length of a pose's axes, metres."],
    ray: [type: :number, default: 3.0, doc: "The length of a ray, metres."],
    thickness: [type: :number, default: 6, doc: "The thickness of lines and joints, millimetres."],
    points: [
      type: :pos_integer,
      default: 100_000,
      doc: "The maximum number of points of a cloud."
    ]
  ]

  # A headset is a page of the studio (WebXR), so no separate program is needed for each make of
  # headset. It shows the scenes of 3D panels: see
  # docs/adr/0121-a-scene-consists-of-nine-kinds-of-items.md. The tests use an emulator (iwer) in
  # Chromium; it was not tried on a real headset.
  use Situ.Component, inputs: [in: :any], options: @schema

  alias Situ.{Error, JSON}
  alias Situ.Studio.{FrameSchema, Headset, Scene}
  alias Situ.Studio.Sensor.Inbox

  @kind FrameSchema.code(:device, :drawing)
  @registry Situ.Studio.Registry
  # A page that reads its messages never has this many in its mailbox.
  @most 100

  @doc "Connects the display to `stream`; returns `stream`."
  @spec show(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def show(stream, opts \\ []) do
    Situ.via(stream, __MODULE__, opts)
    stream
  end

  @doc "Notifies the displays of a page that the page has connected. The page's connection calls this."
  @spec notify_page_opened(module(), String.t()) :: :ok
  def notify_page_opened(kind, name) do
    pattern = {{:display, kind, name, :_}, :"$1", :_}

    for pid <- Registry.select(@registry, [{pattern, [], [:"$1"]}]),
        do: send(pid, {:page_came, self()})

    :ok
  end

  @impl true
  def init(opts) do
    opts = Map.new(opts)

    if opts.color =~ ~r/\A#[0-9a-fA-F]{6}\z/,
      do: {:ok, %{opts: opts, last: nil}},
      else:
        {:error,
         Error.new(:bad_color, "invalid colour #{inspect(opts.color)}", fix: "give it as #rrggbb")}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    case Registry.register(@registry, {:display, Headset, opts.page, opts.as}, nil) do
      {:ok, _} ->
        {[], state}

      {:error, _} ->
        raise Error.new(
                :drawing_taken,
                "the name #{inspect(opts.as)} is already in use in #{inspect(opts.page)}",
                fix: "choose a different as:"
              )
    end
  end

  @impl true
  def handle_message(:in, %{data: data}, _context, %{opts: opts} = state) do
    frame = encode_frame(data, opts)
    with {:ok, pid} <- Inbox.fetch_page(Headset, opts.page), do: send_drawing(pid, frame, opts)
    {[], %{state | last: frame}}
  end

  @impl true
  def handle_info({:page_came, pid}, _context, %{last: frame, opts: opts} = state) do
    if frame, do: send_drawing(pid, frame, opts)
    {[], state}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp send_drawing(pid, frame, opts) do
    with {:message_queue_len, waiting} when waiting < @most <-
           Process.info(pid, :message_queue_len),
         do: send(pid, {:draw, opts.as, frame})
  end

  # Returns the kind, the size of the JSON text, the text, and the scene at a multiple of 8 bytes.
  defp encode_frame(data, opts) do
    {items, problems} =
      Scene.TermItems.collect_items(data, %{budget: opts.points, axis: opts.axis, ray: opts.ray})

    json =
      JSON.encode(%{
        "layer" => opts.as,
        "props" => %{"color" => opts.color, "thickness" => opts.thickness}
      })

    padding = rem(8 - rem(byte_size(json), 8), 8)

    IO.iodata_to_binary([
      FrameSchema.encode(:drawing, %{kind: @kind, bytes: byte_size(json)}),
      json,
      <<0::size(padding)-unit(8)>>,
      Scene.pack(items, problems)
    ])
  end
end
