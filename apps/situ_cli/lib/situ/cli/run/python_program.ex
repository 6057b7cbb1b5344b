defmodule Situ.CLI.Run.PythonProgram do
  @moduledoc false
  # The pipeline of `situ run FILE.py`: a source, or a component over the streams of `--input`.
  alias Situ.{Error, Media, Options, Store}
  alias Situ.Store.StreamInfo

  @type t :: %{path: Path.t(), class: map(), environment: keyword()}
  @quoted ~r/"[^"]*"|'[^']*'/
  @dependencies ~r/^dependencies\s*=\s*\[((?:\s*(?:"[^"]*"|'[^']*')\s*,?)*)\s*\]/m
  @simple ~w(any number integer float string boolean list map)

  @doc "Chooses the class of the file that the options name, or its only one."
  @spec load(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def load(path, opts) do
    with {:ok, text} <- read_file(path),
         environment = list_environment(text, opts),
         {:ok, classes} <- Situ.Python.list_classes(path, environment),
         {:ok, class} <- choose_class(classes, path, opts[:module]),
         do: {:ok, %{path: path, class: class, environment: environment}}
  end

  defp read_file(path) do
    with {:error, reason} <- File.read(path) do
      why = to_string(:file.format_error(reason))
      {:error, Error.new(:not_found, "cannot read #{path}", why: why)}
    end
  end

  defp list_environment(text, opts) do
    # With `--python`, the user names an environment that has the packages.
    listed = if opts[:python], do: nil, else: script_dependencies(text)
    requirements = opts[:requirements] || listed
    [python: opts[:python] || "python3", requirements: requirements]
  end

  @doc "Returns the packages in the metadata of a script (PEP 723), or nil."
  @spec script_dependencies(String.t()) :: [String.t()] | nil
  def script_dependencies(text) do
    with [_, block] <- Regex.run(~r{^# /// script\n((?:#.*\n)+?)# ///$}m, text),
         block = String.replace(block, ~r/^# ?/m, ""),
         [_, list] <- Regex.run(@dependencies, block) do
      for [quoted] <- Regex.scan(@quoted, list), do: String.slice(quoted, 1..-2)
    else
      _none -> nil
    end
  end

  defp choose_class([], path, _name) do
    {:error,
     Error.new(:no_python_class, "#{path} defines no component",
       fix: "define one: class Detector(situ.Component)"
     )}
  end

  defp choose_class([class], _path, nil), do: {:ok, class}

  defp choose_class(classes, path, name) do
    names = Enum.map_join(classes, ", ", & &1["name"])

    case Enum.find(classes, &(&1["name"] == name)) do
      nil when name == nil ->
        what = "#{path} defines several components"
        {:error, Error.new(:several_classes, what, fix: "choose one with --module: #{names}")}

      nil ->
        what = "#{path} defines no component #{name}"
        {:error, Error.new(:no_python_class, what, fix: "it defines: #{names}")}

      class ->
        {:ok, class}
    end
  end

  @doc "Describes the arguments of `setup`, one line each."
  @spec describe_options(t()) :: [String.t()]
  def describe_options(%{class: %{"options" => []}} = program),
    do: ["The component in #{program.path} takes no options."]

  def describe_options(%{class: %{"options" => options}}) do
    for %{"name" => name, "default" => default} <- options,
        do: "#{name}#{if default, do: " (default #{default})", else: " (required)"}"
  end

  @doc "Returns the function that builds the pipeline, with the settings of `--set` as arguments of `setup`."
  @spec build(t(), [{String.t(), term()}], keyword()) ::
          {:ok, (Situ.Pipeline.t() -> term())} | {:error, Error.t()}
  def build(%{class: class} = program, settings, opts) do
    with {:ok, outputs} <- parse_outputs(class["outputs"]),
         {:ok, input} <- choose_input(class, opts[:input], opts[:stream]) do
      source = "#{program.path}:#{class["name"]}"
      own = [options: Map.new(settings), out: outputs] ++ program.environment
      {:ok, fn p -> p |> add_component(source, input, own) |> name_streams(outputs) end}
    end
  end

  # The names are from a program that the user has asked to run.
  defp parse_outputs(outputs) do
    Error.map_ok(outputs, fn [name, type] ->
      with {:ok, type} <- parse_type(type), do: {:ok, {String.to_atom(name), type}}
    end)
  end

  defp parse_type(type) when type in @simple, do: {:ok, String.to_atom(type)}

  defp parse_type(type) do
    module = Module.concat([type])

    if String.starts_with?(type, "Situ.") and Code.ensure_loaded?(module) and
         function_exported?(module, :__struct__, 0) do
      {:ok, module}
    else
      {:error,
       Error.new(:unknown_type, "unknown type of an output: #{inspect(type)}",
         fix: "use #{Enum.join(@simple, ", ")}, or a struct such as Situ.Image"
       )}
    end
  end

  defp choose_input(%{"generates" => true}, nil, _names), do: {:ok, :source}

  defp choose_input(%{"generates" => true, "name" => name}, _path, _names),
    do: {:error, Error.new(:unused_input, "#{name} is a source, so it takes no --input")}

  defp choose_input(class, nil, _names) do
    {:error,
     Error.new(:no_input, "#{class["name"]} has inputs, but there is no --input",
       fix: "add --input with a recording, a file of images or audio, or a camera (situ devices)"
     )}
  end

  defp choose_input(class, path, names) do
    case Store.open(path) do
      {:ok, store} ->
        choose_recorded(class, store, path, names)

      {:error, error} ->
        if recording?(path), do: {:error, error}, else: choose_media(class, path, names)
    end
  end

  # Other files, URLs and devices are media. A path that does not exist is meant to be a recording.
  defp recording?(path), do: File.dir?(path) or not (File.exists?(path) or path =~ ":")

  defp choose_recorded(class, store, path, []) do
    infos = Store.streams(store)

    case for(info <- infos, input = matching_input(class, info), do: {input, info.name}) do
      [one] -> {:ok, {:recording, path, [one]}}
      _several when length(infos) == 1 -> {:ok, {:recording, path, [{nil, hd(infos).name}]}}
      _none_or_several -> {:error, several_streams_error(path, infos)}
    end
  end

  defp choose_recorded(class, store, path, names) do
    with {:ok, chosen} <- Error.map_ok(names, &choose_stream(class, store, &1)),
         do: {:ok, {:recording, path, chosen}}
  end

  # Returns the handler for the type of a stream.
  defp matching_input(class, %StreamInfo{type: type}) do
    word = type |> inspect() |> String.split(".") |> List.last() |> Macro.underscore()

    cond do
      word in class["inputs"] -> word
      word == "encoded_image" and "image" in class["inputs"] -> "image"
      true -> nil
    end
  end

  defp choose_stream(class, store, text) do
    {input, name} =
      case String.split(text, "=", parts: 2) do
        [input, name] -> {input, name}
        [name] -> {only_input(class), name}
      end

    with {:ok, _info} <- Store.stream_info(store, name), do: {:ok, {input, name}}
  end

  defp only_input(%{"inputs" => [input]}) when input not in ["message", "batch"], do: input
  defp only_input(_class), do: nil

  defp several_streams_error(path, infos) do
    Error.new(:several_streams, "#{path} has several streams",
      fix: "choose with --stream: #{Enum.map_join(infos, ", ", & &1.name)}"
    )
  end

  defp choose_media(class, path, []) do
    kind = if "audio_buffer" in class["inputs"], do: :audio, else: :video
    {:ok, {:media, path, kind}}
  end

  defp choose_media(_class, path, [text | _]) do
    case text do
      kind when kind in ["video", "audio"] -> {:ok, {:media, path, String.to_atom(kind)}}
      other -> {:error, unknown_kind_error(other, path)}
    end
  end

  defp unknown_kind_error(name, path) do
    near = Options.nearest_name(name, ["video", "audio"])
    fix = if near, do: "did you mean #{near}?", else: "use --stream video or --stream audio"
    Error.new(:unknown_stream, "#{path} has no stream #{inspect(name)}", fix: fix)
  end

  defp add_component(p, source, :source, opts), do: Situ.Python.source(p, source, opts)

  defp add_component(p, source, {:media, path, kind}, opts) do
    stream = Media.open(p, path)[kind] || raise unknown_kind_error(to_string(kind), path)
    Situ.Python.component(stream, source, opts)
  end

  defp add_component(p, source, {:recording, path, chosen}, opts) do
    importer = Store.importer(p, path)

    streams =
      for {input, name} <- chosen,
          stream = importer |> Store.stream(name) |> decode_images(input),
          do: {input && String.to_atom(input), stream}

    case streams do
      [{nil, stream}] -> Situ.Python.component(stream, source, opts)
      streams -> Situ.Python.component(streams, source, opts)
    end
  end

  # A handler of images needs their pixels. Recordings mostly contain JPEG.
  defp decode_images(%Situ.Stream{type: Situ.EncodedImage} = stream, "image"),
    do: Situ.ImageStream.decode(stream)

  defp decode_images(stream, _input), do: stream

  defp name_streams(%Situ.Stream{} = stream, [{name, _type}]),
    do: Situ.name(stream, to_string(name))

  defp name_streams(streams, outputs),
    do: for({name, _type} <- outputs, do: Situ.name(streams[name], to_string(name)))
end
