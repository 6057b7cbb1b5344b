defmodule Situ.Nx do
  @moduledoc """
  Computes with Nx on streams.

      defmodule Lobby.Level do
        import Nx.Defn

        # {batch, frames, channels} of 16-bit samples to the level of each buffer
        defn rms(samples), do: samples |> Nx.divide(32_768) |> Nx.pow(2) |> Nx.mean(axes: [1, 2]) |> Nx.sqrt()
      end

      audio |> Situ.Nx.map(&Lobby.Level.rms/1, batch: 8) |> Situ.map(&Nx.to_number/1)

  | data | tensor | bytes |
  |---|---|---|
  | `Situ.Tensor` | the same shape and type; `:bool` as `u8` | shared |
  | `Situ.Image` | `{height, width, channels}`, `u8` or `u16`; `{height, width}` for one channel | shared, unless rows are padded |
  | `Situ.DepthImage` | `{height, width}`, `u16` | shared, unless rows are padded |
  | `Situ.AudioBuffer` | `{frames, channels}`, the type of its samples | shared, except 24-bit samples |
  | `Situ.Columns` | `{count}`, `s64`, `f64` or `u8` | shared |
  | a number | a scalar | |
  | a list of numbers | `{n}` | |
  | an `Nx.Tensor` | itself | |

  "Shared" means that Nx's own backend uses the same binary. Other backends, such as EXLA, copy it to their device.
  """
  alias Situ.Nx.{Conversion, MapComponent}

  @schema [
    batch: [
      type: :pos_integer,
      default: 1,
      doc: "The maximum number of messages in one batch."
    ],
    pad: [
      type: :boolean,
      default: true,
      doc:
        "Whether to fill incomplete batches with zeros, so that a compiler sees one shape only."
    ],
    compiler: [
      type: :keyword,
      default: [],
      doc: "Options of `Nx.Defn.jit/2`, such as `compiler: EXLA`."
    ],
    convert: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc: "Converts a message's data before the computation. Default: `to_nx/1` for a function."
    ]
  ]

  @doc """
  Applies a numerical function or an `Nx.Serving` to each message. The results have the originating times of the
  messages.

  The second argument is one of:

    * a function of a tensor, also one made by `defn`. With `batch: 1` it gets the tensor of a message. With a larger
      batch it gets the tensors of up to `batch:` messages stacked (`{batch, ...}`), and returns a tensor, or a tuple or
      map of tensors, whose first dimension is the batch. The messages must have tensors of the same shape.
    * an `Nx.Serving`, such as a model from Bumblebee. It runs in the component's process.
    * the name of a running serving, which several pipelines and other processes share. Each message is one request, and
      the serving batches them.

  A batch contains the messages that are waiting, so a slow stream is not delayed.

  Options, in addition to the options of `Situ.Graph.Placement`:

  #{Situ.Options.docs(@schema)}
  """
  @spec map(Situ.Stream.t(), (Nx.Tensor.t() -> term()) | Nx.Serving.t() | atom(), keyword()) ::
          Situ.Stream.t()
  def map(%Situ.Stream{} = stream, target, opts \\ []) do
    {own, opts} = Keyword.split(opts, Keyword.keys(@schema))
    own = Situ.Options.validate!(own, @schema)
    Situ.via(stream, MapComponent, [run: {target, own}, default_name: "Nx"] ++ opts)
  end

  @doc """
  Converts data of a stream to a tensor, see the table above.

      iex> Situ.Nx.to_nx(Situ.Columns.new([10, 20], [0.5, 1.5])) |> Nx.to_list()
      [0.5, 1.5]
      iex> Situ.Nx.to_nx(3) |> Nx.to_number()
      3
  """
  @spec to_nx(term()) :: Nx.Tensor.t()
  defdelegate to_nx(data), to: Conversion

  @doc """
  Converts a tensor to a `Situ.Tensor`, or to a struct like the second argument, from which `to_nx/1` made a tensor of
  the same shape and type: an image, a depth image, an audio buffer or columns.

      iex> image = Situ.Image.new!(width: 2, height: 1, format: :rgb24, data: <<1, 2, 3, 4, 5, 6>>)
      iex> darker = image |> Situ.Nx.to_nx() |> Nx.quotient(2)
      iex> Situ.Nx.from_nx(darker, image).data
      <<0, 1, 1, 2, 2, 3>>
  """
  @spec from_nx(Nx.Tensor.t(), struct() | nil) :: struct()
  def from_nx(tensor, like \\ nil), do: Conversion.from_nx(tensor, like)

  @doc """
  Returns the values and times of columns, such as the pages of a recording from `Situ.Store.columns/3`, as one tensor
  each: `{times, values}`, both `{n}`. One page is not copied.
  """
  @spec join_columns(Enumerable.t(Situ.Columns.t())) :: {Nx.Tensor.t(), Nx.Tensor.t()}
  def join_columns(columns) do
    parts = for c <- columns, do: {Nx.from_binary(c.times, :s64), to_nx(c)}

    case Enum.unzip(parts) do
      {[times], [values]} -> {times, values}
      {times, values} -> {Nx.concatenate(times), Nx.concatenate(values)}
    end
  end
end
