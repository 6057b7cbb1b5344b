defmodule Situ.Bridge.Mcap.Copy do
  @moduledoc false
  # Copies an MCAP file record by record in native code, without decoding messages.
  #
  # Decoding and encoding each message lost publish times, sequence numbers, channel metadata and
  # custom schemas, and changed equal log times by a nanosecond. The native copy therefore follows
  # the records in the order of the file and does not trust its index. After damage, it continues
  # at the next bytes that look like a record. Only `order: :time` keeps the positions of all
  # messages in memory (24 bytes each).
  alias Situ.Bridge.Mcap.{NativeError, Options, Writer}
  alias Situ.Bridge.Native
  alias Situ.Error

  @options [
             streams: [
               type: {:optional, {:list, :string}},
               default: nil,
               doc: "The names of the streams to copy; default: all, with all schemas."
             ],
             from: [
               type: {:optional, :integer},
               default: nil,
               doc: "The earliest log time to copy, ns."
             ],
             to: [
               type: {:optional, :integer},
               default: nil,
               doc: "The latest log time to copy, ns."
             ],
             order: [
               type: {:in, [:file, :time]},
               default: :file,
               doc:
                 "The order of messages: as in the original, or by log time (stable for messages with equal times)."
             ],
             skip_damage: [
               type: :boolean,
               default: false,
               doc: "Skip damaged data; otherwise damage is an error."
             ],
             progress: [
               type: {:fun, 1},
               default: nil,
               doc: "A function that is called with the number of messages written so far."
             ],
             profile: [
               type: {:optional, :string},
               default: nil,
               doc: "The profile of the file; default: as in the original."
             ],
             compression: [
               type: {:optional, {:in, [:none, :lz4, :zstd]}},
               default: nil,
               doc: "How chunks are compressed; default: as in the original."
             ]
           ] ++ Keyword.take(Options.file_options(), [:chunk, :attachments, :metadata])

  @spec copy_options() :: Situ.Options.schema()
  def copy_options, do: @options

  @spec copy_file(struct(), Path.t(), keyword()) ::
          {:ok, %{messages: non_neg_integer(), left_out: [String.t()]}} | {:error, Error.t()}
  def copy_file(state, path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         {:ok, {copy, writer}} <- begin_copy(state, path, opts) do
      # The errors of a step name the original file, unless the disk is full.
      with {:ok, summary} <- run_steps(copy, opts[:progress] || fn _ -> :ok end, state.path),
           :ok <- Writer.write_extras(writer, opts, path),
           {:ok, _} <- NativeError.wrap_result(Native.mcap_finish(writer), path),
           do: {:ok, summary}
    end
  end

  defp begin_copy(state, path, opts) do
    packing = {opts[:profile], opts[:compression], opts[:chunk]}
    order = if opts[:order] == :time, do: :log, else: :file

    with {:ok, channels} <- channel_ids(state, opts[:streams]) do
      # A metadata record from the options replaces the records of that name.
      metadata_names = for {name, _} <- opts[:metadata], do: to_string(name)
      times = {opts[:from] || 0, opts[:to] || :unbounded}
      selection = {channels, times, order, metadata_names, opts[:skip_damage]}

      state.ref
      |> Native.mcap_copy_begin(path, packing, selection)
      |> NativeError.wrap_result(state.path)
    end
  end

  defp channel_ids(_state, nil), do: {:ok, nil}

  defp channel_ids(state, names) do
    ids = Map.new(state.streams, &{&1.name, &1.id})

    case Enum.reject(names, &is_map_key(ids, &1)) do
      [] ->
        {:ok, Enum.map(names, &ids[&1])}

      [name | _] ->
        {:error, Error.new(:no_stream, "#{state.path} has no stream #{inspect(name)}")}
    end
  end

  defp run_steps(copy, progress, path) do
    case NativeError.wrap_result(Native.mcap_copy_step(copy), path) do
      {:ok, {true, messages, left_out}} ->
        progress.(messages)
        {:ok, %{messages: messages, left_out: left_out}}

      {:ok, {false, messages, _}} ->
        progress.(messages)
        run_steps(copy, progress, path)

      {:error, error} ->
        {:error, error}
    end
  end
end
