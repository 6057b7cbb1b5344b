defmodule Situ.CLI.Run do
  @moduledoc false
  # `situ run`: runs the pipeline of an Elixir file, of a project, or of a Python file.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Desktop, Interrupt, Option, Output, Setting, Terminal, Verb}
  alias Situ.CLI.Run.{Project, PythonProgram, Recorder, Script, Summary, Watcher}
  alias Situ.{Error, Options, Pipeline, Studio}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["run"],
        summary: "run the pipeline of an Elixir file, a project or a Python file",
        about: """
        FILE contains a module with `use Situ.Pipeline`, or ends with a function: fn p -> ... end. It can also be the
        folder of a project (see `situ new`), and is the current folder by default. Ctrl-C stops the pipeline: sources
        end first, messages in flight are delivered, and recordings are closed. Press it again to end at once.

        A Python file contains a class that inherits situ.Component. It is a source, or it gets the streams of --input:
        a recording, a file of images or audio, or a camera (`situ devices`). --set passes arguments to its `setup`,
        and --record records its inputs and outputs.

        A file is compiled and run without restrictions, so use only files that you trust.
        """,
        arguments: [
          file: [
            kind: :file,
            optional: true,
            doc: "an Elixir or Python file, or the folder of a project"
          ]
        ],
        options: verb_options(),
        examples: [
          "situ run lobby.exs",
          "situ run lobby.exs --set threshold=0.6 --record recordings/lobby --studio",
          "situ run lobby.exs --input talk.mp4 --speed max",
          "situ run detector.py --input recordings/lobby --stream Camera --record recordings/faces"
        ],
        run: &run_file/2
      }
    ]
  end

  defp verb_options do
    [
      Option.new(:set, :string, "an option of the pipeline; VALUE is JSON or text",
        value: "NAME=VALUE",
        many?: true
      ),
      Option.new(:input, :path, "the same as --set input=PATH; the input of a Python file",
        value: "PATH"
      ),
      Option.new(:stream, :string, "a stream of --input for a Python file",
        value: "[INPUT=]NAME",
        many?: true
      ),
      Option.new(:python, :path, "the interpreter or virtual environment of a Python file",
        value: "PYTHON"
      ),
      Option.new(:requirements, :path, "make an environment with these packages", value: "FILE"),
      Option.new(:options, :flag, "list the pipeline's options, and do not run it"),
      Option.new(:module, :string, "the pipeline's module or class, if there are several",
        value: "NAME"
      ),
      Option.new(:record, :path, "record the pipeline's named streams", value: "FOLDER/NAME"),
      Option.new(:all, :flag, "with --record: record all streams"),
      Option.new(:studio, :flag, "show the pipeline in the browser until Ctrl-C"),
      Option.new(:port, :integer, "the studio's port; 0 selects a free one", default: 4040),
      Option.new(:open, :flag, "with --studio: do not open the browser", negated?: true),
      Option.new(:speed, :string, "a factor of real time, or max", value: "X|max", default: "1"),
      Option.new(:duration, :span, "stop after this time")
    ]
  end

  defp run_file(%{file: file}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_cli)
    path = file || "."
    speed = parse_speed(opts[:speed])
    check_recording(opts[:record])

    case Error.unwrap!(load_pipeline(path, opts)) do
      {:python, program} -> run_program(program, path, speed, opts)
      {:value, value} -> report_value(value, path, opts)
      {:pipeline, spec} -> run_or_list(spec, path, speed, opts)
    end
  end

  defp load_pipeline(path, opts) do
    cond do
      File.dir?(path) -> Project.load(path, opts[:module])
      Path.extname(path) == ".py" -> load_program(path, opts)
      true -> Script.load(path, opts[:module])
    end
  end

  defp load_program(path, opts) do
    with {:ok, program} <- PythonProgram.load(path, opts), do: {:ok, {:python, program}}
  end

  defp run_program(program, path, speed, opts) do
    if opts[:options] do
      program |> PythonProgram.describe_options() |> Enum.each(&Output.puts/1)
      0
    else
      settings = Setting.parse_settings(opts[:set])
      build = program |> PythonProgram.build(settings, opts) |> Error.unwrap!()
      run_pipeline(build, [], name_run(build, path, speed) ++ opts)
    end
  end

  # The file has run its pipelines itself.
  defp report_value(value, path, opts) do
    if Enum.any?([:record, :studio, :duration, :input], &opts[&1]) or opts[:set] != [] do
      raise Error.new(:no_pipeline, "#{path} has run, but defines no pipeline for these options",
              fix:
                "define a module with `use Situ.Pipeline`, or end the file with `fn p -> ... end`"
            )
    end

    case value do
      {:ok, %Pipeline.Report{} = report} -> report_result({:ok, report}, opts)
      {:error, %Error{} = error} -> raise error
      _other -> 0
    end
  end

  defp run_or_list(spec, path, speed, opts) do
    if opts[:options] do
      list_options(spec, path)
    else
      values = Error.unwrap!(parse_options(spec, path, read_settings(opts)))
      run_pipeline(spec, values, name_run(spec, path, speed) ++ opts)
    end
  end

  defp name_run(spec, path, speed) do
    layouts = if(File.dir?(path), do: path, else: Path.dirname(path)) |> Path.join("layouts")
    [name: pipeline_name(spec, path), speed: speed, layouts: layouts]
  end

  defp read_settings(opts) do
    input = if opts[:input], do: [{"input", opts[:input]}], else: []
    Setting.parse_settings(opts[:set]) ++ input
  end

  defp parse_options(spec, path, settings) do
    case {option_schema(spec), settings} do
      {nil, []} -> {:ok, []}
      {nil, [{name, _} | _]} -> {:error, undeclared_option_error(path, name)}
      {schema, settings} -> Options.parse(Map.new(settings), schema)
    end
  end

  defp option_schema(module) when is_atom(module),
    do: if(function_exported?(module, :options, 0), do: module.options())

  defp option_schema(_function), do: nil

  defp undeclared_option_error(path, name) do
    Error.new(:unknown_option, "the pipeline in #{path} has no option #{inspect(name)}",
      why: "it declares no options",
      fix: "declare it: use Situ.Pipeline, options: [#{name}: [type: ..., doc: ...]]"
    )
  end

  defp list_options(spec, path) do
    case option_schema(spec) do
      none when none in [nil, []] -> Output.puts("The pipeline in #{path} declares no options.")
      schema -> schema |> Setting.describe_options() |> Enum.each(&Output.puts/1)
    end

    0
  end

  defp pipeline_name(module, _path) when is_atom(module),
    do: module |> Module.split() |> List.last()

  defp pipeline_name(_function, path), do: path |> Path.basename() |> Path.rootname()

  defp run_pipeline(spec, values, opts) do
    Process.flag(:trap_exit, true)
    build = if is_atom(spec), do: &spec.build(&1, values), else: spec
    build = if opts[:record], do: Recorder.record(build, opts[:record], opts[:all]), else: build
    studio = if opts[:studio], do: Error.unwrap!(start_studio(opts))

    Interrupt.with_message(:stop, fn ->
      replay = [speed: opts[:speed]]

      pipeline =
        Error.unwrap!(Pipeline.start(build, pipeline: [name: opts[:name], replay: replay]))

      announce_start(studio, opts)
      outcome = await_end(pipeline, opts)
      status = pipeline |> Pipeline.await() |> report_result(opts)
      if studio && outcome == :ended, do: keep_studio(studio)
      status
    end)
  end

  defp await_end(pipeline, opts) do
    if opts[:duration],
      do: Process.send_after(self(), :time_over, div(opts[:duration], 1_000_000))

    terminal = Terminal.open(opts)
    outcome = Watcher.await_end(pipeline, terminal)
    Terminal.close(terminal)
    outcome
  end

  defp start_studio(opts) do
    folder = if opts[:record], do: Path.dirname(opts[:record])
    if folder, do: File.mkdir_p(folder)

    Studio.start_link(
      path: folder,
      pipelines: [{opts[:name], opts[:name]}],
      port: opts[:port],
      layouts: if(File.dir?(opts[:layouts]), do: opts[:layouts])
    )
  end

  defp announce_start(studio, opts) do
    unless opts[:json] or opts[:quiet],
      do: Output.warn("#{opts[:name]} is running; Ctrl-C stops it")

    if studio do
      url = Studio.url(studio, Studio.only_item(studio))
      Output.warn("The studio shows it at #{url}")
      if opts[:open], do: Desktop.open_url(url)
    end
  end

  defp report_result({:ok, report}, opts) do
    Summary.print(Summary.new(report, opts[:record] != nil), opts)
    0
  end

  defp report_result({:error, error}, _opts), do: raise(error)

  # After Ctrl-C everything ends. If the pipeline has ended by itself, its recording can still be viewed.
  defp keep_studio(studio) do
    Output.warn("The pipeline has ended. The studio keeps running until Ctrl-C.")

    receive do
      :stop -> :ok
      {:EXIT, ^studio, _reason} -> :ok
    end
  end

  defp parse_speed("max"), do: :max

  defp parse_speed(text) do
    case Float.parse(text) do
      {speed, ""} when speed > 0 -> speed
      _ -> throw({:usage, "--speed takes a number above 0, or max, not #{inspect(text)}"})
    end
  end

  defp check_recording(nil), do: :ok

  defp check_recording(path) do
    if Path.basename(path) in ["", ".", "/"] or String.ends_with?(path, "/"),
      do:
        throw(
          {:usage, "--record takes FOLDER/NAME, such as recordings/lobby, not #{inspect(path)}"}
        )
  end
end
