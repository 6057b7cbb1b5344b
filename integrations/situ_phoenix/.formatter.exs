[
  inputs: ["{mix,.formatter}.exs", "{lib,test,examples}/**/*.{ex,exs}"],
  import_deps: [:phoenix],
  locals_without_parens: [situ_studio: 1, situ_studio: 2],
  export: [locals_without_parens: [situ_studio: 1, situ_studio: 2]]
]
