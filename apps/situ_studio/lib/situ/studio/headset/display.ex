defmodule Situ.Studio.Headset.Display do
  @schema [
    page: [type: :string, default: "headset", doc: "The headset's name."],
    as: [
      type: :string,
      default: "shown",
      doc: "The drawing's name: streams shown at once have different ones."
    ],
    color: [type: :string, default: "#4ea1ff", doc: "As `#rrggbb`, of what has none of its own."],
    axis: [type: :number, default: 0.1, doc: "The length of a pose's axes, metres."],
    ray: [type: :number, default: 3.0, doc: "The length of a ray, metres."],
    thickness: [type: :number, default: 6, doc: "Of lines and joints, millimetres."],
    points: [type: :pos_integer, default: 100_000, doc: "Points of a cloud at most."]
  ]

  @moduledoc """
  Draws in a headset (`Situ.Studio.Headset`) what a stream says: poses, rays, boxes, texts with a place, rectangles,
  pictures, meshes, clouds, skeletons and all else that a 3D panel draws (`Situ.Studio.Scene.Terms`).

      objects
      |> Situ.map(fn {name, box} -> {name, box} end)
      |> Situ.Studio.Headset.Display.show(as: "objects", color: "#ffcc00")

  A message replaces what the one before it drew; one with nothing to draw clears it. Places are in the headset's own
  frame (x forward, y left, z up, from where its session began). A page that comes later gets the last message. While
  one drawing is on its way, of those that follow only the newest is kept.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component, inputs: [in: :any], options: @schema

  alias Situ.{Error, JSON}
  alias Situ.Studio.{Headset, Scene}
  alias Situ.Studio.Sensor.Inbox

  @registry Situ.Studio.Registry
  # More than that a page that reads has not left lying.
  @most 100

  @doc "Connects the display to `stream`; returns `stream`."
  @spec show(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def show(stream, opts \\ []) do
    Situ.via(stream, __MODULE__, opts)
    stream
  end

  @doc "Tells the displays of a page that it is there. For the page's connection."
  @spec page_came(module(), String.t()) :: :ok
  def page_came(kind, name) do
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
         Error.new(:bad_color, "#{inspect(opts.color)} is no colour", fix: "give it as #rrggbb")}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    case Registry.register(@registry, {:display, Headset, opts.page, opts.as}, nil) do
      {:ok, _} ->
        {[], state}

      {:error, _} ->
        raise Error.new(
                :drawing_taken,
                "something is shown as #{inspect(opts.as)} in #{inspect(opts.page)} already",
                fix: "give this one another as:"
              )
    end
  end

  @impl true
  def handle_message(:in, %{data: data}, _context, %{opts: opts} = state) do
    frame = frame(data, opts)
    with {:ok, pid} <- Inbox.page(Headset, opts.page), do: draw(pid, frame, opts)
    {[], %{state | last: frame}}
  end

  @impl true
  def handle_info({:page_came, pid}, _context, %{last: frame, opts: opts} = state) do
    if frame, do: draw(pid, frame, opts)
    {[], state}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp draw(pid, frame, opts) do
    with {:message_queue_len, waiting} when waiting < @most <-
           Process.info(pid, :message_queue_len),
         do: send(pid, {:draw, opts.as, frame})
  end

  # The kind, the size of a JSON text, the text, and the scene at a multiple of 8.
  defp frame(data, opts) do
    {items, problems} =
      Scene.Terms.of(data, %{budget: opts.points, axis: opts.axis, ray: opts.ray})

    json =
      JSON.encode(%{
        "layer" => opts.as,
        "props" => %{"color" => opts.color, "thickness" => opts.thickness}
      })

    padding = rem(8 - rem(byte_size(json), 8), 8)

    IO.iodata_to_binary([
      <<5, 0::24, byte_size(json)::little-32>>,
      json,
      <<0::size(padding)-unit(8)>>,
      Scene.pack(items, problems)
    ])
  end
end
