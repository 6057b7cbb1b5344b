defmodule Situ.Python do
  @moduledoc """
  Components that are written in Python.

      faces =
        Situ.Python.component(camera, "detector.py:Detector",
          python: ".venv",
          options: [threshold: 0.6],
          out: [faces: {:list, Situ.Rect}]
        )

  The file `detector.py`:

      import situ

      class Detector(situ.Component):
          def setup(self, threshold):
              self.threshold = threshold

          def on_image(self, image, message):
              pixels = image.array        # a numpy array, without a copy
              return {"faces": [situ.Struct("Situ.Rect", {"x": 1, "y": 2, "width": 30, "height": 40})]}

  Each component has a separate operating system process with its own interpreter. A crash, an endless loop or a full
  memory there is an error of the component, which `on_error:` handles; it never affects the VM. The process ends with
  the component, even if the VM is killed. The package `situ` needs no installation in the environment.

  ## Inputs and outputs

  The method `on_NAME(self, value, message)` handles the input NAME, and `on_message` all inputs without a method. With
  several streams, `[left: a, right: b]`, the list names the inputs. A single stream of a struct has the last
  word of the type as its name: `image` for `Situ.Image`, `audio_buffer` for `Situ.AudioBuffer`. All other single
  streams are named `value`, also streams of type `:any`.

  A handler returns a dict of outputs, `None`, or a list of dicts. Results have the time of the message and are emitted
  in the order of the messages. A tuple `(time, dict)` in the list has its own time.
  `batch:` hands several values to one call (`on_batch`), and `max:` starts several workers for one stream. The methods
  `snapshot` and `restore` make the state part of checkpoints. `source/3` adds a source that is a generator.

  The guide `docs/guides/python-components.md` describes the values.

  ## Errors

  An exception becomes an error with Python's traceback (`why` and `meta.traceback`) and the time of the message. Then
  `on_error:` decides:

    * `:stop` ends the pipeline;
    * `:skip` loses the message. The Python object keeps its state, unless the process has ended;
    * `:restart` loses the message and starts a new process, with a new `setup`.

  The messages after it are handled in all cases, by the new process if the old one has ended.
  """
  alias Situ.{Argument, Error, Options, Stream}
  alias Situ.Graph.Placement
  alias Situ.Python.{ClassList, Component, SingleComponent, Source, Workers}

  @schema [
    python: [
      type: :string,
      default: "python3",
      doc: "An interpreter: a name in `PATH`, a path, or the folder of a virtual environment."
    ],
    requirements: [
      type: {:optional, {:or, [:string, {:list, :string}]}},
      default: nil,
      doc:
        "A file of requirements, or a list like `[\"scikit-learn==1.5.0\"]`. At the first start, `uv` or `pip` " <>
          "installs them into an environment for `python`, which all later starts use."
    ],
    options: [
      type: {:or, [:keyword, :map]},
      default: [],
      doc: "Keyword arguments of the method `setup`: a keyword list or map of plain data."
    ],
    out: [
      type: :keyword,
      default: [out: :any],
      doc: "Names and types of the outputs. Every value is checked."
    ],
    max: [
      type: :pos_integer,
      default: 1,
      doc:
        "Number of workers, each a separate process with its own object. They take the messages in turn, and their " <>
          "results are emitted in the order of the messages. For components that do not depend on earlier messages."
    ],
    batch: [
      type: :pos_integer,
      default: 1,
      doc: "Largest number of messages for one call of `on_batch`. A batch never waits for more."
    ],
    timeout: [
      type: {:or, [:pos_integer, {:in, [:infinity]}]},
      default: 30_000,
      doc:
        "Longest time for one message or batch, in ms of real time; then the process is killed."
    ],
    start_timeout: [
      type: :pos_integer,
      default: 120_000,
      doc: "Longest time for imports and `setup`, in ms. The pipeline starts after them."
    ],
    memory: [
      type: {:optional, :pos_integer},
      default: nil,
      doc:
        "Limit of the address space of the process, in bytes; beyond it, Python raises `MemoryError`."
    ],
    shared_memory: [
      type: :pos_integer,
      default: 268_435_456,
      doc: "Limit of the memory for large values in each direction, in bytes; the rest is copied."
    ]
  ]

  @doc """
  Adds a component that is written in Python. `source` is `"FILE.py:CLASS"` or `"MODULE:CLASS"`. Returns the output
  stream, or a map of streams if there are several outputs.

  #{Options.docs(@schema)}

  It also accepts the options of components in `Situ.Graph.Placement`, such as `on_error:`, `policy:` and `name:`.
  """
  @spec component(Stream.t() | keyword(Stream.t()), String.t(), keyword()) ::
          Stream.t() | %{atom() => Stream.t()}
  def component(streams, source, opts \\ [])

  def component(%Stream{} = stream, source, opts),
    do: component([{input_name(stream.type), stream}], source, opts)

  def component([{_, %Stream{}} | _] = streams, source, opts) do
    {own, placement} = Placement.split_options!(opts, @schema, :component)
    {file, class} = split_source!(source)

    settings = [
      source: file,
      class: class,
      input_names: Keyword.keys(streams),
      output_types: own[:out],
      errors: placement[:on_error]
    ]

    placement = Keyword.put_new(placement, :default_name, class)
    {outputs, own} = Keyword.pop(own ++ settings, :out)
    {count, own} = Keyword.pop(own, :max)
    add_component(streams, count, %{own: own, placement: placement, outputs: outputs})
  end

  def component(other, _source, _opts),
    do:
      Argument.raise_invalid!(
        other,
        :stream,
        ~s|Situ.Python.component(stream, "detector.py:Detector")|
      )

  defp add_component([{input, stream}], count, settings) when count > 1 do
    settings = %{settings | own: settings.own ++ [grouped: true]}
    Workers.add_workers(stream, input, Map.put(settings, :count, count))
  end

  defp add_component(streams, 1, settings) do
    ports = [
      inputs: for({input, stream} <- streams, do: {input, stream.type}),
      outputs: settings.outputs
    ]

    module = if length(streams) == 1, do: SingleComponent, else: Component
    Situ.via(streams, module, settings.own ++ [grouped: false] ++ ports ++ settings.placement)
  end

  defp add_component(_streams, count, _settings) do
    raise Error.new(:bad_option, "max: #{count} needs a single stream",
            why: "several workers take the messages in turn, so they would see different inputs",
            fix: "zip or join the streams first, or leave out max:"
          )
  end

  @source_schema Keyword.drop(@schema, [:batch, :max])
                 |> put_in([:timeout, :default], :infinity)
                 |> put_in(
                   [:timeout, :doc],
                   "Longest time for one value, in ms of real time; then the process is killed."
                 )

  @doc """
  Adds a source that is written in Python: a class with the method `produce`, a generator of results.

      class Camera(situ.Component):
          def produce(self):
              while True:
                  yield {"image": read_image()}

  Results without a time have the time at which they are yielded. Python is asked for the next value when the outputs
  have room. The end of the generator completes the source. Returns the output stream, or a map of streams.

  #{Options.docs(@source_schema)}
  """
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) ::
          Stream.t() | %{atom() => Stream.t()}
  def source(p, source, opts \\ []) do
    {own, placement} = Placement.split_options!(opts, @source_schema, :component)
    {file, class} = split_source!(source)
    settings = [source: file, class: class, output_types: own[:out], batch: 1, errors: :stop]
    own = Keyword.delete(own, :out) ++ settings ++ [outputs: own[:out]]
    Situ.source(p, Source, own ++ Keyword.put_new(placement, :default_name, class))
  end

  @doc """
  Returns the components in a Python file, as maps with their `name`, `inputs`, `outputs` and `options`. `generates` is
  true for sources. The file is executed. `opts` are `python:` and `requirements:` as in `component/3`.
  """
  @spec list_classes(Path.t(), keyword()) :: {:ok, [map()]} | {:error, Error.t()}
  defdelegate list_classes(path, opts \\ []), to: ClassList

  defp input_name(type) when is_atom(type) do
    case Atom.to_string(type) do
      "Elixir." <> _ ->
        type |> Module.split() |> List.last() |> Macro.underscore() |> String.to_atom()

      _simple ->
        :value
    end
  end

  defp input_name(_type), do: :value

  defp split_source!(source) do
    case String.split(source, ":") do
      [file, class] when file != "" and class != "" ->
        {file, class}

      _ ->
        raise Error.new(:bad_python_source, "#{inspect(source)} does not name a Python class",
                why: "it must be a file or a module, a colon and a class",
                fix: ~s|for example, "detector.py:Detector" or "lab.detectors:Detector"|
              )
    end
  end
end
