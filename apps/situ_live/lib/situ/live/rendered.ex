defmodule Situ.Live.Rendered do
  @moduledoc """
  The result of `~H`: the template's static strings and the values between them.

  `n + 1` strings enclose `n` values. A value is an escaped string, another `Rendered`, a `Situ.Live.Comprehension`, a
  `Situ.Live.Island`, or `:unchanged` (since the last render). `fingerprint` identifies the template; `root?` is true if
  the template is exactly one tag.
  """
  @enforce_keys [:static, :dynamic, :fingerprint]
  defstruct [:static, :dynamic, :fingerprint, root?: false]

  @type value ::
          binary() | t() | Situ.Live.Comprehension.t() | Situ.Live.Island.t() | :unchanged
  @type t :: %__MODULE__{
          static: [binary()],
          dynamic: [value()],
          fingerprint: integer(),
          root?: boolean()
        }
end

defmodule Situ.Live.Comprehension do
  @moduledoc """
  The result of `:for`: one template for all entries, and `{key, values}` for each. An entry that keeps its key also
  keeps its DOM node when it moves. `stream` is set for a `Situ.Live.Stream`.
  """
  @enforce_keys [:static, :entries, :fingerprint]
  defstruct [:static, :entries, :fingerprint, stream: nil]

  @type t :: %__MODULE__{
          static: [binary()],
          entries: [{term(), [Situ.Live.Rendered.value()]}],
          fingerprint: integer(),
          stream: nil | list()
        }
end

defmodule Situ.Live.Island do
  @moduledoc """
  A part of a page that the browser patches separately: see `Situ.Live.Component.island/1`.
  """
  @enforce_keys [:rendered]
  defstruct [:rendered]

  @type t :: %__MODULE__{rendered: Situ.Live.Rendered.t()}
end
