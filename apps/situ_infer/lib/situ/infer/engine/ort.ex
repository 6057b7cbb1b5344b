defmodule Situ.Infer.Engine.Ort do
  @moduledoc false
  # The ONNX Runtime engine. The library is loaded at run time.
  #
  # The path of the shared library is `SITU_ONNXRUNTIME` if that is set, and otherwise
  # `priv/onnxruntime/libonnxruntime.so` of this app, where `bin/setup` installs it. Without the
  # library, everything that needs a model returns `:no_onnxruntime` with the fix. A failed
  # attempt is not remembered, so models work as soon as the library is installed.
  # See docs/adr/0060-onnx-runtime-is-loaded-at-run-time.md.
  @behaviour Situ.Infer.Engine

  alias Situ.{Error, Tensor}
  alias Situ.Infer.Native

  @types Map.new(
           [:f16, :bf16, :f32, :f64, :s8, :s16, :s32, :s64, :u8, :u16, :u32, :u64, :bool],
           &{Atom.to_string(&1), &1}
         )

  @impl true
  def load(bytes, opts) do
    with :ok <- ensure_library(),
         {:ok, {handle, inputs, outputs}} <-
           Native.load_model(
             bytes,
             opts[:threads],
             opts[:sessions],
             device_id(opts[:provider]),
             opts[:folder]
           ) do
      {:ok,
       %{
         handle: handle,
         inputs: Enum.map(inputs, &decode_port/1),
         outputs: Enum.map(outputs, &decode_port/1)
       }}
    else
      {:error, %Error{}} = error -> error
      {:error, {kind, text}} -> {:error, native_error(kind, text)}
    end
  end

  @impl true
  def run(handle, inputs, where) do
    rows = for {name, t} <- inputs, do: {name, to_string(t.type), Tuple.to_list(t.shape), t.data}

    case run_native(where, handle, rows) do
      {:ok, outputs, spent} -> {:ok, Map.new(outputs, &decode_tensor/1), spent}
      {:error, {kind, text}} -> {:error, native_error(kind, text)}
    end
  end

  # A second caller must not block a normal scheduler, so it waits on a dirty one.
  defp run_native(:dirty, handle, rows), do: Native.run_dirty(handle, rows)

  defp run_native(:inline, handle, rows) do
    with :busy <- Native.run_inline(handle, rows), do: Native.run_dirty(handle, rows)
  end

  @doc "Loads ONNX Runtime, unless it is loaded. Error: `:no_onnxruntime`."
  @spec ensure_library() :: :ok | {:error, Situ.Error.t()}
  def ensure_library do
    path = library_path()

    cond do
      Native.runtime_version() -> :ok
      File.regular?(path) -> load_library(path)
      true -> {:error, missing_library(path)}
    end
  end

  defp library_path do
    System.get_env("SITU_ONNXRUNTIME") ||
      Path.join(to_string(:code.priv_dir(:situ_infer)), "onnxruntime/libonnxruntime.so")
  end

  defp load_library(path) do
    case Native.load_runtime(path) do
      :ok -> :ok
      {:error, {kind, text}} -> {:error, native_error(kind, text)}
    end
  end

  defp missing_library(path) do
    Error.new(:no_onnxruntime, "ONNX Runtime is not installed: no file #{path}",
      why: "models run in ONNX Runtime, which is loaded together with the first model",
      fix:
        "run bin/setup, or set SITU_ONNXRUNTIME to a libonnxruntime.so of version 1.24 or newer"
    )
  end

  defp native_error(:library, text) do
    Error.new(:no_onnxruntime, "ONNX Runtime cannot be opened: #{text}",
      why: "the file is not an ONNX Runtime library for this machine, or it is older than 1.24",
      fix: "run bin/setup again, or set SITU_ONNXRUNTIME to a working libonnxruntime.so"
    )
  end

  defp native_error(:model, "External data" <> _ = text) do
    Error.new(:bad_model, "the model's weights cannot be read: #{text}",
      why:
        "the model file refers to another file that contains its weights (ONNX's external data)",
      fix: "put that file next to the model file, under the name that the model uses"
    )
  end

  defp native_error(:model, text) do
    Error.new(:bad_model, "not a usable ONNX model: #{text}",
      why:
        "the file is truncated or corrupt, or needs operators that this ONNX Runtime does not have",
      fix: "download the model file again"
    )
  end

  defp native_error(:provider, text) do
    Error.new(:no_provider, "the execution provider cannot be used: #{text}",
      fix: "use provider: :cpu, or a library built with CUDA through SITU_ONNXRUNTIME"
    )
  end

  defp native_error(:input, text), do: Error.new(:bad_tensor, text)

  defp native_error(:run, text) do
    Error.new(:model_failed, "the model failed: #{text}",
      why: "ONNX Runtime stopped in the middle of a run",
      fix:
        "check the sizes and values of the inputs; if they are correct, the model file is faulty"
    )
  end

  defp device_id(:cpu), do: -1
  defp device_id({:cuda, device}), do: device

  defp decode_port({name, type, shape}),
    do: {name, Map.get(@types, type, :unsupported), List.to_tuple(shape)}

  defp decode_tensor({name, type, shape, data}) do
    {name, %Tensor{type: Map.fetch!(@types, type), shape: List.to_tuple(shape), data: data}}
  end
end
