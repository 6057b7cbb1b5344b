defmodule Situ.CLI.Store.PanelFiles do
  @moduledoc false
  # Writes the content of the studio's panels to files for `situ store save`: an HTML page of the streams, and a video
  # of images with other streams drawn over them.
  alias Situ.CLI.{Option, Output, UnfinishedOutput}
  alias Situ.CLI.Store.OutputFile
  alias Situ.{Error, Store}
  alias Situ.Studio.{PageExport, VideoExport}

  @doc "Returns the options of videos."
  @spec options() :: [Option.t()]
  def options do
    [
      Option.new(
        :over,
        :string,
        "MP4: draw this stream of rectangles, points, texts or masks over the images",
        value: "STREAM",
        many?: true
      ),
      Option.new(:sound, :string, "MP4: with the sound of this stream", value: "STREAM")
    ]
  end

  @doc "Writes the page, after stating its size, and returns the fields for `--json`."
  @spec save_page(Store.t(), [Store.StreamInfo.t()], Path.t(), keyword(), function()) :: map()
  def save_page(store, infos, file, opts, progress) do
    {source, export} = open_export(store, infos, opts)
    built = PageExport.build_page(export, source, &progress.(round(100 * &1), 100))
    {page, notes} = unwrap_page!(built)

    unless opts[:json] do
      Output.puts("#{file}: #{format_megabytes(page)}, #{count_streams(export)}")
      Enum.each(notes, &Output.puts/1)
    end

    out = OutputFile.open_output(file)
    OutputFile.write_bytes(out, page)
    OutputFile.close_output(out)
    %{bytes: byte_size(page), notes: notes}
  end

  defp unwrap_page!({:ok, page, notes}), do: {page, notes}
  defp unwrap_page!({:error, error}), do: raise(error)

  # Without --stream and --exclude, the page has the panels that the studio would show.
  defp open_export(store, infos, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)
    source = Error.unwrap!(PageExport.open_recording(store))
    {from, to} = find_interval!(store, opts)
    chosen = if opts[:stream] || opts[:exclude], do: Enum.map(infos, & &1.name), else: :automatic
    title = Path.basename(store.path)
    {source, Error.unwrap!(PageExport.new(source, title, {from, to}, chosen))}
  end

  defp find_interval!(store, opts) do
    {first, last} = Store.interval(Store.streams(store)) || {0, 1}
    from = max(opts[:from] || first, first)
    to = min(opts[:to] || last, last)

    if to <= from do
      raise Error.new(:empty, "there are no messages between these times",
              fix: "`situ store info` shows the times of a recording"
            )
    end

    {from, to}
  end

  defp format_megabytes(page),
    do: :erlang.float_to_binary(byte_size(page) / 1.0e6, decimals: 2) <> " MB"

  defp count_streams(export) do
    case length(PageExport.list_streams(export)) do
      1 -> "1 stream"
      n -> "#{n} streams"
    end
  end

  @doc """
  Writes a video of a stream. Images that are stored as video are copied; with `--over` or `--sound`, they are encoded.
  """
  @spec save_video(Store.t(), Store.StreamInfo.t(), Path.t(), keyword(), function()) :: map()
  def save_video(store, info, file, opts, progress) do
    if opts[:over] || opts[:sound],
      do: encode_video(store, info, file, opts, progress),
      else: copy_video(store, info, file, opts, progress)
  end

  defp copy_video(store, info, file, opts, progress) do
    copying = Keyword.take(opts, [:from, :to]) ++ [progress: &progress.(&1, info.count)]

    %{
      messages: Error.unwrap!(Situ.Media.copy_video(store, info.name, file, copying)),
      stream: info.name
    }
  end

  defp encode_video(store, info, file, opts, progress) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)
    over = opts[:over] || []
    for name <- over ++ List.wrap(opts[:sound]), do: Error.unwrap!(Store.stream_info(store, name))
    {from, to} = find_interval!(store, opts)

    source = Error.unwrap!(PageExport.open_recording(store))
    drawn = [over: over, sound: opts[:sound]]
    film = Error.unwrap!(VideoExport.new(info.name, {from, to}, source, drawn))
    tell = &progress.(round(100 * &1), 100)

    OutputFile.write_then_rename!(file, fn unfinished ->
      # The encoder chooses the format by the extension.
      encoded = unfinished <> Path.extname(file)
      UnfinishedOutput.remove_file_at_exit(file, Path.extname(file))

      with :ok <- VideoExport.write_video(film, source, encoded, tell),
           :ok <- File.rename(encoded, unfinished),
           do: {:ok, nil}
    end)

    %{stream: info.name, over: over, sound: opts[:sound]}
  end
end
