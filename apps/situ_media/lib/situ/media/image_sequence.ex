defmodule Situ.Media.ImageSequence do
  @moduledoc """
  A source of images from JPEG and PNG files.

      p |> Situ.Media.ImageSequence.open("shots/", rate: 10) |> Situ.each(&IO.inspect/1)

  Files of a folder or a pattern are sorted by the numbers in their names (`shot-2` before `shot-10`). A folder written
  by `Situ.Media.ImageSequenceWriter` also contains the originating times, and they are used. All other images get steps
  of `1 / rate` from `start_time:`.
  """

  alias Situ.Graph.Placement
  alias Situ.{Error, Image, ImageOps}
  alias Situ.Media.FileTime
  alias Situ.Media.ImageSequence.Index

  @schema [
    files: [
      type: {:or, [:string, {:list, :string}]},
      required: true,
      doc: "A folder, a pattern (`\"shots/*.png\"`), or an ordered list of files."
    ],
    rate: [
      type: :number,
      default: 25,
      doc: "Images per second, for files without stored times."
    ],
    format: [
      type: {:optional, {:in, Image.Format.list_all()}},
      default: nil,
      doc: "Convert to this pixel format; `nil`: as in the files."
    ],
    start_time: FileTime.start_time_option(),
    on_damage: [
      type: {:in, [:error, :skip]},
      default: :error,
      doc: "For an unreadable image: end with the error, or skip the image and log a warning."
    ]
  ]

  use Situ.Component, outputs: [out: Image], options: @schema

  require Logger

  @doc "Adds the source and returns its stream. Raises `Situ.Error` if no image is found."
  @spec open(Situ.Pipeline.t(), Path.t() | [Path.t()], keyword()) :: Situ.Stream.t()
  def open(p, files, opts \\ []) do
    {opts, placed} = Placement.split_options!([files: files] ++ opts, @schema, :component)
    {recorded_at, [{first, _} | _] = shots} = list_shots!(opts)
    {last, _} = List.last(shots)
    stream = Situ.source(p, __MODULE__, opts ++ placed)
    FileTime.propose_replay(p, opts[:start_time], recorded_at, {first, last})
    stream
  end

  @impl true
  def init(opts), do: {:ok, %{opts: opts, shots: [], offset: 0, last: 0, damage: nil}}

  @impl true
  def handle_start(context, %{opts: opts} = state) do
    {recorded_at, shots} = list_shots!(opts)
    offset = FileTime.time_offset(opts[:start_time], recorded_at, 0, context)
    {from, to} = FileTime.read_span(offset, {0, nil}, context)
    shots = Enum.filter(shots, fn {time, _} -> time >= from and (to == nil or time < to) end)
    {[], %{state | shots: shots, offset: offset, last: offset + from}}
  end

  @impl true
  def handle_demand(_n, _context, %{shots: []} = state), do: {[{:complete, state.last}], state}

  def handle_demand(_n, context, %{shots: [{time, path} | rest]} = state) do
    state = %{state | shots: rest}

    case ImageOps.read(path, format: state.opts[:format]) do
      {:ok, image} ->
        time = time + state.offset
        {[{:out, time, image}], %{state | last: time}}

      {:error, error} ->
        handle_damage(error, context, state)
    end
  end

  @impl true
  def handle_stop(_final_time, _context, %{damage: nil} = state), do: {[], state}
  def handle_stop(_final_time, _context, %{damage: error}), do: raise(error)

  @doc """
  Returns a sort key that orders files by the numbers in their names.

      iex> Enum.sort_by(["a10.png", "a9.png", "b1.png"], &Situ.Media.ImageSequence.sort_key/1)
      ["a9.png", "a10.png", "b1.png"]
  """
  @spec sort_key(Path.t()) :: term()
  def sort_key(path) do
    for part <- Regex.split(~r/\d+/, Path.basename(path), include_captures: true) do
      case Integer.parse(part) do
        {number, ""} -> {0, number}
        _ -> {1, part}
      end
    end
  end

  defp handle_damage(error, context, %{opts: opts} = state) do
    if opts[:on_damage] == :skip do
      Logger.warning(Exception.message(error))
      handle_demand(1, context, state)
    else
      {[{:complete, state.last}], %{state | shots: [], damage: error}}
    end
  end

  # `{recorded_at, [{media time, file}]}`
  defp list_shots!(opts) do
    with {:ok, files} <- list_files(opts[:files]), {:ok, shots} <- assign_times(files, opts) do
      shots
    else
      {:error, error} -> raise error
    end
  end

  defp list_files(list) when is_list(list), do: check_any(list, "the list of images is empty")

  defp list_files(pattern) do
    found =
      if File.dir?(pattern),
        do: Path.wildcard(Path.join(pattern, "*.{jpg,jpeg,png,JPG,JPEG,PNG}")),
        else: Path.wildcard(pattern)

    found |> Enum.sort_by(&sort_key/1) |> check_any("no images found at #{inspect(pattern)}")
  end

  defp check_any([], what),
    do: {:error, Error.new(:no_file, what, fix: "use JPEG or PNG files: .jpg, .jpeg, .png")}

  defp check_any(files, _what), do: {:ok, files}

  defp assign_times(files, opts) do
    index = is_binary(opts[:files]) && Index.index_path(opts[:files])

    if index && File.exists?(index) do
      with {:ok, [{zero, _} | _] = shots} <- Index.read_shots(index),
           do: {:ok, {zero, Enum.map(shots, fn {time, file} -> {time - zero, file} end)}}
    else
      {:ok,
       {nil,
        files |> Enum.with_index() |> Enum.map(fn {f, i} -> {frame_time(i, opts[:rate]), f} end)}}
    end
  end

  defp frame_time(i, rate) when is_integer(rate), do: Situ.Media.Nut.to_ns(i, {1, rate})
  defp frame_time(i, rate), do: round(i * 1.0e9 / rate)
end
