defmodule Situ.Studio.PageExport do
  @moduledoc false
  # Writes panels of a recording between two times as one HTML page that opens without a server:
  # the studio's panels and script, with their messages in the page. See
  # docs/adr/0204-an-exported-page-carries-messages-not-drawings.md.
  alias Situ.Error
  alias Situ.{Recording, Store}
  alias Situ.Recording.Formats
  alias Situ.Studio.Annotations.Home
  alias Situ.Studio.{Coverage, Layout, Recordings, StreamColors, StreamOverview}
  alias Situ.Studio.PageExport.{Contents, Page}

  @enforce_keys [:title, :layout, :from, :to]
  defstruct [:title, :layout, :from, :to, visualizers: []]

  @typedoc "`visualizers` are the studio's additions to the built-in ones. Their code is not part of the page."
  @type t :: %__MODULE__{
          title: String.t(),
          layout: Layout.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          visualizers: [Situ.Studio.Visualizer.definition()]
        }

  # Browsers open larger pages slowly, or not at all.
  @most_bytes 200_000_000

  @doc "Opens a recording with its annotations, as the studio does."
  @spec open_recording(Store.t()) :: {:ok, Recording.t()} | {:error, Error.t()}
  def open_recording(%{path: path}) do
    with {:ok, source} <- Recordings.Store.open(path) do
      home = unless Formats.for_address(path), do: Home.recording_home(path)
      {:ok, Recordings.Layers.add_layers(source, "", home)}
    end
  end

  @doc """
  Creates the export of the panels that the studio shows automatically (`:automatic`), or of all of the named streams.
  """
  @spec new(Recording.t(), String.t(), {Situ.Time.t(), Situ.Time.t()}, :automatic | [String.t()]) ::
          {:ok, t()} | {:error, Error.t()}
  def new(source, title, {from, to}, chosen) do
    with {:ok, infos} <- StreamOverview.list_streams(source) do
      layout = build_layout(source, infos, chosen)
      {:ok, %__MODULE__{title: title, layout: layout, from: from, to: to}}
    end
  end

  defp build_layout(source, infos, :automatic) do
    looks = Layout.ImageLook.detect_looks(source, infos)
    Layout.Auto.build_layout(infos, looks, Layout.SignalRange.detect_ranges(source, infos))
  end

  # The automatic layout leaves out some of many streams, which are appended.
  defp build_layout(source, infos, names) do
    chosen = Enum.filter(infos, &(&1.name in names))
    append_rest(build_layout(source, chosen, :automatic), source, chosen)
  end

  defp append_rest(layout, source, chosen) do
    case Layout.left_out(layout, chosen) do
      [] ->
        layout

      rest ->
        more = Layout.append(layout, build_layout(source, rest, :automatic))

        if length(Layout.left_out(more, chosen)) < length(rest),
          do: append_rest(more, source, chosen),
          else: layout
    end
  end

  @doc "Returns the names of the streams that the page shows."
  @spec list_streams(t()) :: [String.t()]
  def list_streams(%__MODULE__{layout: layout}),
    do: for(panel <- layout.panels, v <- panel.vis, uniq: true, do: v.stream)

  @doc """
  Builds the page and returns its bytes, and sentences about the streams that it reduces or leaves out. Calls `progress`
  with the completed fraction. Errors: `:no_streams` and `:page_too_large`.
  """
  @spec build_page(t(), Situ.Recording.t(), (float() -> term())) ::
          {:ok, binary(), notes :: [String.t()]} | {:error, Error.t()}
  def build_page(%__MODULE__{} = export, source, progress) do
    with {:ok, infos} <- StreamOverview.list_streams(source),
         {:ok, export} <- keep_known_streams(export, infos),
         {:ok, data, notes} <- Contents.collect(export, source, progress) do
      page = Page.render(export, known_facts(export, infos), data, notes)
      if byte_size(page) > @most_bytes, do: too_large(page), else: {:ok, page, notes}
    end
  end

  @doc "Writes the page to a file, and returns the same as `build_page/3` with the size instead of the bytes."
  @spec write_page(t(), Situ.Recording.t(), Path.t(), (float() -> term())) ::
          {:ok, bytes :: pos_integer(), notes :: [String.t()]} | {:error, Error.t()}
  def write_page(export, source, path, progress) do
    with {:ok, page, notes} <- build_page(export, source, progress),
         :ok <- write_file(path, page),
         do: {:ok, byte_size(page), notes}
  end

  defp write_file(path, page) do
    with {:error, reason} <- File.write(path, page) do
      {:error,
       Error.new(:not_saved, "cannot write #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  defp too_large(page) do
    {:error,
     Error.new(:page_too_large, "the page would have #{div(byte_size(page), 1_000_000)} MB",
       why: "browsers open pages of up to #{div(@most_bytes, 1_000_000)} MB",
       fix: "choose a shorter time or fewer streams"
     )}
  end

  @doc "Reduces the layout to the streams with these names."
  @spec keep_streams(t(), [String.t()]) :: t()
  def keep_streams(%__MODULE__{layout: layout} = export, names) do
    layout =
      for %{id: id, vis: vis} <- layout.panels,
          {%{stream: stream}, index} <- vis |> Enum.with_index() |> Enum.reverse(),
          stream not in names,
          reduce: layout,
          do: (layout -> Layout.remove_vis(layout, id, index))

    %{export | layout: layout}
  end

  # A layout may name streams that the recording does not have.
  defp keep_known_streams(export, infos) do
    export = keep_streams(export, Enum.map(infos, & &1.name))

    if export.layout.panels == [],
      do:
        {:error,
         Error.new(:no_streams, "the page would show no streams",
           fix: "choose streams of this recording"
         )},
      else: {:ok, export}
  end

  defp known_facts(export, infos) do
    extent = %{from: export.from, to: export.to, live: false}

    within =
      for %{first: first} = info when first != nil <- infos,
          do: %{info | first: max(first, export.from), last: min(info.last, export.to)}

    %{
      shapes: Map.new(infos, &{&1.name, &1.shape}),
      extra: export.visualizers,
      lanes: for(%{keys: [_ | _] = keys} = s <- infos, into: %{}, do: {s.name, length(keys)}),
      coverage: Coverage.find_partial_streams(within, extent),
      colors: StreamColors.rank_streams(Enum.map(infos, & &1.name)),
      damaged: false
    }
  end
end
